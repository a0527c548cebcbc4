/* Makes, resets and frees instances, and lays out their memory. */

#ifndef ALFMU_LIFETIME_H
#define ALFMU_LIFETIME_H

#include <stddef.h>

#include "instance.h"
#include "scene.h"

#include "internal_begin.h"

/* How many numbers an instance of a scene has, which finds its start by itself or only makes steps. */
size_t instance_length(const Scene *s, int starts);

/* Of these, how many it keeps, and how many are free between two calls, so that instances may share them. */
size_t instance_kept_length(const Scene *s);
size_t instance_lent_length(const Scene *s, int starts);

/* An instance with so many numbers; both are zero. Where `lent` is not NULL, `numbers` are those that it keeps. */
void instance_lay(Instance *i, const Scene *s, double *numbers, double *lent, int starts);

/* Go on with other numbers of those that are free between two calls, the constants of the scene among them. */
void instance_borrow(Instance *i, double *lent, int starts);

Instance *instance_new(const Scene *s);
void instance_free(Instance *i);
void instance_reset(Instance *i);

#include "internal_end.h"

#endif
