/* Reads the programs of a scene file and checks every place in them. */

#pragma once

#include "scene.h"
#include "scene_reader.h"

void programs_read(Reader *r);
