/* Steps up to the events of dry friction. */

#pragma once

#include "instance.h"

#ifndef WITHOUT_FRICTION
void friction_distances(Instance *i, double *found);
Outcome friction_cover(Instance *i, double start, double h, double dt);
#else
static inline void friction_distances(Instance *i, double *found) { (void)i, (void)found; }
static inline Outcome friction_cover(Instance *i, double start, double h, double dt)
{
    return (void)i, (void)start, (void)h, (void)dt, DONE;
}
#endif
