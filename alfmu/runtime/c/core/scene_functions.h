/* Reads the functions of a scene file and checks every place in them. */

#pragma once

#include "scene_reader.h"

void function_is_shaped(Reader *r, const char *name, int which, int needed, int inputs, int outputs, ...);
void functions_read(Reader *r);
