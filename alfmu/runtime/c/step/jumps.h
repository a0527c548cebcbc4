/* Laws of motion that jump or are not finite. */

#ifndef ALFMU_JUMPS_H
#define ALFMU_JUMPS_H

#include <stddef.h>

#include "instance.h"
#include "scene.h"

#include "internal_begin.h"

size_t laws_room(const Scene *s);
Outcome laws_checked(Instance *i, double end);
Outcome laws_begun(Instance *i, Outcome outcome);

#include "internal_end.h"

#endif
