/* Penalties in proportion to the masses that each constraint holds. */

#ifndef ALFMU_PENALTIES_H
#define ALFMU_PENALTIES_H

#include "instance.h"

void penalties_default(Instance *i, const double *q, double *penalties);

#endif
