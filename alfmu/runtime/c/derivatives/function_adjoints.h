/* Adjoints back through one function of a scene. */

#ifndef ALFMU_FUNCTION_ADJOINTS_H
#define ALFMU_FUNCTION_ADJOINTS_H

#include "gradient.h"

#include "internal_begin.h"

void adjoints_through(const Flat *flat, const double *r, double *ar);

#include "internal_end.h"

#endif
