/* Values and derivatives of a component, by arrays of references. */

#pragma once

#include "component.h"
#include "gradient.h"

Status component_get(Component *c, const unsigned *references, size_t count, void *values, size_t value_count,
    Value_type form, const char *call);
Status component_set(Component *c, const unsigned *references, size_t count, const void *values, size_t value_count,
    Value_type form, const char *call);
Status component_slopes(Component *c, const unsigned *references, size_t count, const int *orders,
    const double *values, const char *call);
Status component_output_derivatives(Component *c, const unsigned *references, size_t count, const int *orders,
    double *values, size_t value_count, const char *call);
Status component_derivative(Component *c, const unsigned *unknowns, size_t unknown_count, const unsigned *knowns,
    size_t known_count, const double *seed, size_t seed_count, double *found, size_t found_count, Sweep *back,
    const char *call);
