/* Internal steps of an integrator with error control. */

#pragma once

#include "instance.h"

#ifndef WITHOUT_ERROR_CONTROL
int step_adaptive(Instance *i, double end, long tries);
#else
static inline int step_adaptive(Instance *i, double end, long tries) { return (void)i, (void)end, (void)tries, 0; }
#endif
