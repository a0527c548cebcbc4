/* The scene is a constant table. */

#ifndef ALFMU_RESOURCES_H
#define ALFMU_RESOURCES_H

#include <stddef.h>

#include "scene.h"

static Scene *scene_of_fmu(const char *resources, char *why, size_t why_size)
{
    (void)resources;
    (void)why;
    (void)why_size;
    return (Scene *)(void *)&the_scene;
}

static void scene_free(Scene *s)
{
    (void)s;
}

#endif
