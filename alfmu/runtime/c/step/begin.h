/* The start of a run: assembly, penalties and settings. */

#ifndef ALFMU_BEGIN_H
#define ALFMU_BEGIN_H

#include "instance.h"

Outcome instance_initialize(Instance *i);
Outcome instance_begin(Instance *i, double start, double stop);

#endif
