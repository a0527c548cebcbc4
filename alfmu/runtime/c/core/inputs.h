#ifndef ALFMU_INPUTS_H
#define ALFMU_INPUTS_H

#include "instance.h"

#include "internal_begin.h"

void inputs_within(const Instance *i, double from, double time, double *u, double *du);

#include "internal_end.h"

#endif
