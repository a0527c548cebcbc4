/* Runs programs and functions for several instances of a scene at the same time, each in a lane of its own. The numbers
   are those of one after the other. */

#ifndef ALFMU_SIDE_BY_SIDE_H
#define ALFMU_SIDE_BY_SIDE_H

#include "instance.h"
#include "lanes.h"

#include "internal_begin.h"

typedef struct {
    Instance *instances[LANES];
    const double *const *x[LANES]; /* of a function: where its arguments are, and where its results go */
    double *const *y[LANES];
    int count;
    Lanes *registers; /* [registers of the scene], the constants of the scene loaded */
} Group;

void group_run_program(const Group *g, int program);
void group_call_function(const Group *g, int function);

#include "internal_end.h"

#endif
