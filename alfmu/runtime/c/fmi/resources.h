/* Finds the scene among the resources of an FMU. */

#pragma once

#include "scene.h"

/* Load the scene from the resources folder of an FMU, given as a URI or a path. */
Scene *scene_of_fmu(const char *resources, char *why, size_t why_size);
