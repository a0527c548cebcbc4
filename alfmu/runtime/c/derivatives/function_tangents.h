/* Tangents through one function of a scene. */

#pragma once

#include "gradient.h"
#include "lanes.h"

void tangent_along(Lanes *d, double partial, const Lanes *tangent);

/* Propagate tangents, or adjoints, through a function whose registers hold the values, if the arguments have their
   tangents, or the results their adjoints. */
void tangents_through(const Flat *flat, const double *r, Lanes *dr);
