/* Finds massless bodies that no constraint holds, and the lightest motion. */

#pragma once

#include "instance.h"

Outcome masses_check(Instance *i, const double *q, const unsigned char *held);
double masses_lightest(Instance *i, const double *q, const unsigned char *held, const double *masses);
