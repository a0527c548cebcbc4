/* Laws of motion that jump or are not finite. */

#pragma once

#include "instance.h"
#include "scene.h"

#ifndef WITHOUT_LAWS
size_t laws_room(const Scene *s);
Outcome laws_checked(Instance *i, double end);
Outcome laws_begun(Instance *i, Outcome outcome);
#else
static inline size_t laws_room(const Scene *s) { return (void)s, 0; }
static inline Outcome laws_checked(Instance *i, double end) { return (void)i, (void)end, DONE; }
static inline Outcome laws_begun(Instance *i, Outcome outcome) { return (void)i, outcome; }
#endif
