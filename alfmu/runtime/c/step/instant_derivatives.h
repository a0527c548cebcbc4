/* Derivatives of outputs at an instant: by inputs, and before the run by parameters and start values. */

#ifndef ALFMU_INSTANT_DERIVATIVES_H
#define ALFMU_INSTANT_DERIVATIVES_H

#include <stddef.h>

#include "instance.h"
#include "scene.h"

#include "internal_begin.h"

/* The same by inputs, and before the run by parameters and start values: along a direction of what is known, or back from
   one of what is not. */
int variable_has_derivatives(const Scene *s, int reference);

int instance_moves_start(const Instance *i);
Outcome instance_sweep(Instance *i, const unsigned *unknowns, size_t unknown_count, const unsigned *knowns,
    size_t known_count, const double *seed, int back, double *found);

#include "internal_end.h"

#endif
