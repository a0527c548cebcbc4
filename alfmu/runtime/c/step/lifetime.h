/* Makes, resets and frees instances, and lays out their memory. */

#ifndef ALFMU_LIFETIME_H
#define ALFMU_LIFETIME_H

#include <stddef.h>

#include "instance.h"
#include "scene.h"

#include "internal_begin.h"

/* How many numbers an instance of a scene has, which finds its start by itself or only makes steps. */
size_t instance_length(const Scene *s, int starts);

/* An instance with so many numbers; both are zero. */
void instance_lay(Instance *i, const Scene *s, double *numbers, int starts);

Instance *instance_new(const Scene *s);
void instance_free(Instance *i);
void instance_reset(Instance *i);

#include "internal_end.h"

#endif
