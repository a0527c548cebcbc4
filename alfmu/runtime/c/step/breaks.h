/* Times at which forces, laws of motion or rates of states jump or have a kink. */

#pragma once

#include "instance.h"
#include "scene.h"

/* Most breaks in a communication step. */
#define MOST_BREAKS 4096

#ifndef WITHOUT_BREAKS
size_t breaks_room(const Scene *s);
Outcome breaks_found(Instance *i, double begin, double end);
#else
static inline size_t breaks_room(const Scene *s) { return (void)s, 0; }
static inline Outcome breaks_found(Instance *i, double begin, double end)
{
    return (void)i, (void)begin, (void)end, DONE;
}
#endif
