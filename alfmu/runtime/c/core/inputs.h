#pragma once

#include "instance.h"

void inputs_within(const Instance *i, double from, double time, double *u, double *du);
