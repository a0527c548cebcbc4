/* Finds the scene among the resources of an FMU. */

#ifndef ALFMU_RESOURCES_H
#define ALFMU_RESOURCES_H

#include <stddef.h>

#include "scene.h"

#include "internal_begin.h"

/* The scene among the resources of an FMU, which the host names by a URI or a path. */
Scene *scene_of_fmu(const char *resources, char *why, size_t why_size);

#include "internal_end.h"

#endif
