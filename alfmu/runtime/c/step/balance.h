/* The energy balance of a run and the warnings that follow from it. */

#pragma once

#include "instance.h"

/* Velocity [m/s, rad/s] below which the energy of a motion is too small to judge the balance. */
#define SLOW_MOTION 1e-5

void instance_balance(Instance *i);
void balance_tell_step_error(Instance *i);
