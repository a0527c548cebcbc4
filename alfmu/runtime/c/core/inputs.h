#ifndef ALFMU_INPUTS_H
#define ALFMU_INPUTS_H

#include "instance.h"

void inputs_within(const Instance *i, double from, double time, double *u, double *du);

#endif
