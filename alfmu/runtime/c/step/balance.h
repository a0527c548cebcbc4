/* The energy balance of a run, and the warnings that follow from it. */

#ifndef ALFMU_BALANCE_H
#define ALFMU_BALANCE_H

#include "instance.h"

#include "internal_begin.h"

/* Velocities [m/s, rad/s] of a motion whose energy is too little to judge a balance by. */
#define SLOW_MOTION 1e-5

void instance_balance(Instance *i);
void balance_tell_step_error(Instance *i);

#include "internal_end.h"

#endif
