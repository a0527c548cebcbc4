/* Finds massless bodies that no constraint holds. */

#pragma once

#include "instance.h"

Outcome masses_check(Instance *i, const double *q, const unsigned char *held);
