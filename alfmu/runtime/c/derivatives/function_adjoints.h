/* Adjoints back through one function of a scene. */

#ifndef ALFMU_FUNCTION_ADJOINTS_H
#define ALFMU_FUNCTION_ADJOINTS_H

#include "gradient.h"

void adjoints_through(const Flat *flat, const double *r, double *ar);

#endif
