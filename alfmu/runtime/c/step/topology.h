/* Boolean inputs that take effect: changes of the constraints in force, and impacts. */

#pragma once

#include "instance.h"

#ifndef WITHOUT_SWITCHES
Outcome topology_change(Instance *i, const double *on);
Outcome topology_take_effect(Instance *i);
#else
static inline Outcome topology_take_effect(Instance *i) { return (void)i, DONE; }
#endif
