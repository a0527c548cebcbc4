/* Runs the functions and programs of a scene. */

#ifndef ALFMU_INTERPRET_H
#define ALFMU_INTERPRET_H

#include "instance.h"
#include "scene.h"

#include "internal_begin.h"

/* Evaluate a function whose arguments are in the registers. */
void function_evaluate(const Function *f, double *r, double *values);

/* A function of the scene on arrays; a program on the memory. */
void function_call(Instance *i, int which, const double *const *x, double *const *y);

/* Return the first place at which lanes fill whole cache lines; load the constants into the registers, once these are
   allocated. */
double *lanes_align(double *place);

void registers_load(Instance *i);
void program_run(Instance *i, int program);

/* A call of a function on arrays of the instance, written down. */
void function_call_recorded(Instance *i, int which, const double *const *x, double *const *y);

#include "internal_end.h"

#endif
