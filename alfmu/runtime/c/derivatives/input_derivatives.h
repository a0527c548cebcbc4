/* Derivatives of the polynomials of driving inputs. */

#pragma once

#include "gradient.h"
#include "record.h"

#ifndef WITHOUT_MOVING_INPUTS
void aimed_tangents(Gradient *g, const Entry *e);
void aimed_adjoints(Gradient *g, const Entry *e);
#else
static inline void aimed_tangents(Gradient *g, const Entry *e) { (void)g, (void)e; }
static inline void aimed_adjoints(Gradient *g, const Entry *e) { (void)g, (void)e; }
#endif
