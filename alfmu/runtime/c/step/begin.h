/* The start of a run: assembly, penalties and settings. */

#ifndef ALFMU_BEGIN_H
#define ALFMU_BEGIN_H

#include "instance.h"

#include "internal_begin.h"

Outcome instance_initialize(Instance *i);
Outcome instance_begin(Instance *i, double start, double stop);

#include "internal_end.h"

#endif
