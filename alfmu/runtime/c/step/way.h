/* Finds the direction in which positions of a limit lie where it is not that of the motion. */

#ifndef ALFMU_WAY_H
#define ALFMU_WAY_H

#include "instance.h"

#include "internal_begin.h"

double *way_of(Instance *i);
void way_begin(Instance *i, const unsigned char *held, const double *q, const double *v);
void way_update(Instance *i);

#include "internal_end.h"

#endif
