/* Finds massless bodies that no constraint holds. */

#ifndef ALFMU_MASSES_H
#define ALFMU_MASSES_H

#include "instance.h"

Outcome masses_check(Instance *i, const double *q, const unsigned char *held);

#endif
