/* Penalties in proportion to the masses that each constraint holds. */

#pragma once

#include "instance.h"

void penalties_default(Instance *i, const double *q, double *penalties);
