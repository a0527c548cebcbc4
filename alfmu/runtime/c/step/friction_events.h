/* Steps up to the events of dry friction. */

#ifndef ALFMU_FRICTION_EVENTS_H
#define ALFMU_FRICTION_EVENTS_H

#include "instance.h"

#include "internal_begin.h"

Outcome friction_cover(Instance *i, double start, double h, double dt);

#include "internal_end.h"

#endif
