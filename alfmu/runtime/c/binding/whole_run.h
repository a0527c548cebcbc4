/* A run in one call, as a binding asks for it. */

#ifndef ALFMU_WHOLE_RUN_H
#define ALFMU_WHOLE_RUN_H

#include "instance.h"

#include "internal_begin.h"

/* A run in one call: a grid of communication points, inputs at each, the variables that are wanted at each. */
typedef struct {
    const double *times; /* communication points, the start first */
    long count;
    const int *inputs; /* references of inputs, by columns of `table`, a row for each communication point */
    int input_count;
    const double *table;
    const int *wanted; /* references, by columns of `values` */
    int wanted_count;
    double *values;
    int (*progress)(long done); /* callback a few times a second, or NULL; zero interrupts the run */
} Run;

/* Make a run and return the number of its rows; `done` is set to the communication steps that are made while it goes
   on. */
long whole_run_make(Instance *i, const Run *r, long *done, Outcome *outcome);

#include "internal_end.h"

#endif
