/* Makes the start velocities consistent with the constraints. */

#pragma once

#include "instance.h"
#include "loops.h"

Outcome start_rates(Instance *i, Loops *loops, const double *q, double *v);
void start_find_way(Instance *i, const unsigned char *held, const double *q, int equal, double *way);
