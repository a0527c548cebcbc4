/* The interface Jacobian: outputs at the end of a communication step by inputs held over it. */

#pragma once

#include "instance.h"

#ifndef WITHOUT_INTERFACE_JACOBIAN
Outcome jacobian_begin(Instance *i);
void jacobian_along(Instance *i);
Outcome jacobian_end(Instance *i);
#else
static inline Outcome jacobian_begin(Instance *i) { return (void)i, DONE; }
static inline void jacobian_along(Instance *i) { (void)i; }
static inline Outcome jacobian_end(Instance *i) { return (void)i, DONE; }
#endif
