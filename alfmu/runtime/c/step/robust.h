/* Steps where the tiers of the kernel fail. */

#pragma once

#include "instance.h"

Outcome step_robust(Instance *i, double start, double dt);
Outcome step_rk4(Instance *i, double start, double dt);
Outcome step_adaptive_to(Instance *i, double end, double dt, int once);
