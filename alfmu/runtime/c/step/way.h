/* Finds the direction along which a limit at a singular position is taken, if it is not the motion's. */

#pragma once

#include "instance.h"

#ifndef WITHOUT_LIMITS
void way_begin(Instance *i, const unsigned char *held, const double *q, const double *v);
void way_update(Instance *i);
#else
static inline void way_begin(Instance *i, const unsigned char *held, const double *q, const double *v)
{
    (void)i, (void)held, (void)q, (void)v;
}

static inline void way_update(Instance *i) { (void)i; }
#endif
