/* Adjoints back through one function of a scene. */

#pragma once

#include "gradient.h"

void adjoints_through(const Flat *flat, const double *r, double *ar);
