/* Tangents through one function of a scene. */

#ifndef ALFMU_FUNCTION_TANGENTS_H
#define ALFMU_FUNCTION_TANGENTS_H

#include "gradient.h"
#include "lanes.h"

#include "internal_begin.h"

void tangent_along(Lanes *d, double partial, const Lanes *tangent);

/* Tangents and adjoints of a function, once its registers have their values and the arguments their tangents, or the
   results their adjoints. */
BY_PROCESSOR void tangents_through(const Flat *flat, const double *r, Lanes *dr);

#include "internal_end.h"

#endif
