/* Steps where the tiers of the kernel fail. */

#ifndef ALFMU_ROBUST_H
#define ALFMU_ROBUST_H

#include "instance.h"

Outcome step_robust(Instance *i, double start, double dt);
Outcome step_rk4(Instance *i, double start, double dt);
Outcome step_adaptive_to(Instance *i, double end, double dt, int once);

#endif
