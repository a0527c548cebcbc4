/* Internal steps of an integrator with error control. */

#ifndef ALFMU_ADAPTIVE_H
#define ALFMU_ADAPTIVE_H

#include "instance.h"

#include "internal_begin.h"

int step_adaptive(Instance *i, double end, long tries);

#include "internal_end.h"

#endif
