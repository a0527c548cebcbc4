/* Reads the programs of a scene file and checks every place in them. */

#ifndef ALFMU_SCENE_PROGRAMS_H
#define ALFMU_SCENE_PROGRAMS_H

#include "scene.h"
#include "scene_reader.h"

void programs_read(Reader *r);

#endif
