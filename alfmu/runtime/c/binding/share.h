/* Lets results within a function share places. */

#pragma once

#include "scene.h"

/* Give a function a copy of its narrow code, in `code` [words + results], in which results share places; `registers`
   becomes the number of places, the constants' included. Return whether there is memory for this. */
int share_in_copy(Function *f, uint16_t *code, int constants);
