/* The interface Jacobian: outputs at the end of a communication step by inputs that are held over it. */

#ifndef ALFMU_INTERFACE_JACOBIAN_H
#define ALFMU_INTERFACE_JACOBIAN_H

#include "instance.h"

#include "internal_begin.h"

Outcome jacobian_begin(Instance *i);
void jacobian_along(Instance *i);
Outcome jacobian_end(Instance *i);

#include "internal_end.h"

#endif
