/* Makes the start velocities consistent with the constraints. */

#ifndef ALFMU_VELOCITIES_H
#define ALFMU_VELOCITIES_H

#include "instance.h"
#include "loops.h"

Outcome start_rates(Instance *i, Loops *loops, const double *q, double *v);
void start_find_way(Instance *i, const unsigned char *held, const double *q, int equal, double *way);

#endif
