/* Finds the scene among the resources of an FMU. */

#ifndef ALFMU_RESOURCES_H
#define ALFMU_RESOURCES_H

#include <stddef.h>

#include "scene.h"

/* Load the scene from the resources folder of an FMU, given as a URI or a path. */
Scene *scene_of_fmu(const char *resources, char *why, size_t why_size);

#endif
