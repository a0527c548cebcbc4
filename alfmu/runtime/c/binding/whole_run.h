/* A run in one call, for bindings. */

#pragma once

#include "instance.h"

/* A run in one call: communication points, inputs and requested variables at each of them. */
typedef struct {
    const double *times; /* communication points, the start first */
    long count;
    const int *inputs; /* references of inputs, the columns of `table`, which has a row for each communication point */
    int input_count;
    const double *table;
    const int *wanted; /* references of variables, the columns of `values` */
    int wanted_count;
    double *values;
    int (*progress)(long done); /* called a few times a second unless NULL; the run stops if it returns zero */
} Run;

/* Make a run and return the number of its rows; `done` counts completed communication steps during the run. */
long whole_run_make(Instance *i, const Run *r, long *done, Outcome *outcome);
