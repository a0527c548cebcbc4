/* Programs and functions run for several instances of a scene at the same time, each in a lane of its own. Results
   are those of one instance after the other, to the last bit. */

#pragma once

#include "instance.h"
#include "lanes.h"

typedef struct {
    Instance *instances[LANES];
    const double *const *x[LANES]; /* arguments and results of a function, by lane */
    double *const *y[LANES];
    int count;
    Lanes *registers; /* with the scene's constants loaded */
    const Function *functions; /* the scene's, with code for lanes */
} Group;

void group_run_program(const Group *g, int program);
void group_call_function(const Group *g, int function);
