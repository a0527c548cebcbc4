/* Derivatives of the polynomials of driving inputs. */

#ifndef ALFMU_INPUT_DERIVATIVES_H
#define ALFMU_INPUT_DERIVATIVES_H

#include "gradient.h"
#include "record.h"

#ifndef WITHOUT_MOVING_INPUTS
void aimed_tangents(Gradient *g, const Entry *e);
void aimed_adjoints(Gradient *g, const Entry *e);
#else
static inline void aimed_tangents(Gradient *g, const Entry *e) { (void)g, (void)e; }
static inline void aimed_adjoints(Gradient *g, const Entry *e) { (void)g, (void)e; }
#endif

#endif
