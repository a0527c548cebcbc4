/* Evaluates the outputs at this instant, by the first of several tiers that can. */

#pragma once

#include "instance.h"

Outcome instance_set(Instance *i, int reference, double value);
Outcome instance_tolerate(Instance *i, double tolerance);
int outputs_read_away(Instance *i);
Outcome instance_read(Instance *i);
int outputs_read_quickly(Instance *i);
Outcome outputs_get_many(Instance *i, const int *references, int count, double *values);
