/* Makes, resets and frees instances, and lays out their memory. */

#ifndef ALFMU_LIFETIME_H
#define ALFMU_LIFETIME_H

#include "instance.h"
#include "scene.h"

#include "internal_begin.h"

Instance *instance_new(const Scene *s);
void instance_free(Instance *i);
void instance_reset(Instance *i);

#include "internal_end.h"

#endif
