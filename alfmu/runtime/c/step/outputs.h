/* Evaluates the outputs at this instant, by the first of several tiers that can. */

#ifndef ALFMU_OUTPUTS_H
#define ALFMU_OUTPUTS_H

#include <stddef.h>

#include "instance.h"

#include "internal_begin.h"

Outcome instance_set(Instance *i, int reference, double value);
Outcome instance_tolerate(Instance *i, double tolerance);
int outputs_read_away(Instance *i);
Outcome instance_read(Instance *i);
Outcome instance_derivative(Instance *i, const unsigned *unknowns, size_t unknown_count, const unsigned *knowns,
    size_t known_count, const double *directions, double *changes);
int outputs_read_quickly(Instance *i);

#include "internal_end.h"

#endif
