/* Programs and functions run for several instances of a scene at the same time, each in a lane of its own. Results
   are those of one instance after the other, to the last bit. */

#pragma once

#include "instance.h"
#include "lanes.h"

#define MEMBERS 64 /* most members of a group: after choices of programs, those of one way still fill lanes */

typedef struct {
    Instance *instances[MEMBERS];
    const double *const **x; /* arguments and results of a function, by member */
    double *const **y;
    int count;
    Lanes *registers; /* with the scene's constants loaded */
    const Function *functions; /* the scene's, with code for lanes */
} Group;

void group_run_program(const Group *g, int program);

/* Call a function with the arguments x[instance] and results y[instance]. */
void group_call_function(const Group *g, int function, const double *const **x, double *const **y);
