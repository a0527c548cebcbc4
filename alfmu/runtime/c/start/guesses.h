/* Start values that the assembly missed or that were given in degrees, and assemblies beyond the limits of stops. */

#pragma once

#include "instance.h"
#include "loops.h"
#include "record.h"

void guesses_check(Instance *i, Loops *loops, const double *guess, const double *q);
void guesses_keep_limits(Instance *i, Loops *loops, const double *guess, double *q, Mark begin);
