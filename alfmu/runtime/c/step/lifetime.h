/* Makes, resets and frees instances, and lays out their memory. */

#pragma once

#include "instance.h"
#include "scene.h"

/* Return how many numbers an instance of a scene has, if it finds its start itself (`starts`) or only makes steps. */
size_t instance_length(const Scene *s, int starts);

/* Return how many of these it keeps between calls, and how many it uses only during calls, which instances may share.
   */
size_t instance_kept_length(const Scene *s);
size_t instance_lent_length(const Scene *s, int starts);

/* Initialise a zeroed instance on zeroed `numbers` of that count. If `lent` is not NULL, `numbers` holds only those
   that the instance keeps. */
void instance_lay(Instance *i, const Scene *s, double *numbers, double *lent, int starts);

/* Replace the numbers used only during a call by others, and load the constants of the scene there. */
void instance_borrow(Instance *i, double *lent, int starts);

Instance *instance_new(const Scene *s);
void instance_free(Instance *i);
void instance_reset(Instance *i);
