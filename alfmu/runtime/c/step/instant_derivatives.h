/* Derivatives of outputs at an instant: by inputs, and before the run by parameters and start values. */

#pragma once

#include "gradient.h"
#include "instance.h"
#include "message.h"
#include "scene.h"

#ifndef WITHOUT_DERIVATIVES
/* Differentiate outputs with respect to inputs and, before the run, to parameters and start values: along a direction
   of the knowns, or, if `back` is not NULL, backwards for weights of the unknowns. */
int variable_has_derivatives(const Scene *s, int reference);

int instance_moves_start(const Instance *i);
Outcome instance_sweep(Instance *i, const unsigned *unknowns, size_t unknown_count, const unsigned *knowns,
    size_t known_count, const double *seed, Sweep *back, double *found);
#else
static inline int variable_has_derivatives(const Scene *s, int reference) { return (void)s, (void)reference, 0; }
static inline int instance_moves_start(const Instance *i) { return (void)i, 0; }
static inline Outcome instance_sweep(Instance *i, const unsigned *unknowns, size_t unknown_count,
    const unsigned *knowns, size_t known_count, const double *seed, Sweep *back, double *found)
{
    (void)unknowns, (void)unknown_count, (void)knowns, (void)known_count, (void)seed, (void)back, (void)found;
    return instance_say(i, REFUSED,
        "%s: it was exported without derivatives; export it as --kind native with --derivatives", i->scene->name);
}
#endif
