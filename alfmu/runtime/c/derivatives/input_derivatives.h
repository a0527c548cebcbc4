/* Derivatives of the course of inputs that move something. */

#ifndef ALFMU_INPUT_DERIVATIVES_H
#define ALFMU_INPUT_DERIVATIVES_H

#include "gradient.h"
#include "record.h"

#include "internal_begin.h"

void aimed_tangents(Gradient *g, const Entry *e);
void aimed_adjoints(Gradient *g, const Entry *e);

#include "internal_end.h"

#endif
