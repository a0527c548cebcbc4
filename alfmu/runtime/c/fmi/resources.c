#include "resources.h"

#include <stdio.h>
#include <stdlib.h>

#include "files.h"
#include "scene.h"

#define SCENE_NAME "scene.bin"

Scene *scene_of_fmu(const char *resources, char *why, size_t why_size)
{
    char folder[LONGEST_PATH] = "";
    unsigned char *bytes = NULL;
    size_t size = 0;
    Scene *s;
    if (resources) {
        files_path_of(resources, folder);
        bytes = files_read(folder, SCENE_NAME, &size);
    }
    if (!bytes) {
        char own[LONGEST_PATH];
        files_own_resources(own);
        bytes = files_read(own, SCENE_NAME, &size);
    }
    if (!bytes) {
        snprintf(why, why_size, "there is no scene.bin in its resources (%.400s); unpack the whole FMU", folder);
        return NULL;
    }
    s = scene_load(bytes, size, why, why_size);
    free(bytes);
    return s;
}
