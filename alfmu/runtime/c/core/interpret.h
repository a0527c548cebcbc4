/* Runs the functions and programs of a scene. */

#pragma once

#include "instance.h"
#include "scene.h"

void function_evaluate(const Function *f, double *r, double *values);

/* Call a function of the scene on arrays. */
void function_call(Instance *i, int which, const double *const *x, double *const *y);
void function_call_alone(Instance *i, int which, const double *const *x, double *const *y); /* without `wait` */

/* Call a function with arguments and results at places in the memory. */
void function_call_at(Instance *i, const Function *f, const Word *at);

/* Parts of programs, for callers that run several instances together. */
const Word *routine_run(Instance *i, const Word *at);
int loop_goes_on(Instance *i, const Word *at, int times);

/* Load the constants into the registers, once these are allocated. */
void registers_load(Instance *i);
void program_run(Instance *i, int program);

/* Call a function on arrays of the instance, recorded if there is a tape. */
void function_call_recorded(Instance *i, int which, const double *const *x, double *const *y);
