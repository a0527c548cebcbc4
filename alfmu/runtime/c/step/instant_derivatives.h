/* Derivatives of outputs at an instant: by inputs, and before the run by parameters and start values. */

#ifndef ALFMU_INSTANT_DERIVATIVES_H
#define ALFMU_INSTANT_DERIVATIVES_H

#include <stddef.h>

#include "instance.h"
#include "scene.h"

#include "internal_begin.h"

/* Differentiate outputs with respect to inputs and, before the run, to parameters and start values: along a
   direction of the knowns, or back from a direction of the unknowns. */
int variable_has_derivatives(const Scene *s, int reference);

int instance_moves_start(const Instance *i);
Outcome instance_sweep(Instance *i, const unsigned *unknowns, size_t unknown_count, const unsigned *knowns,
    size_t known_count, const double *seed, int back, double *found);

#include "internal_end.h"

#endif
