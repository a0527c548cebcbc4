/* S1: scales of pivots, and what masses contribute to the margin. */

#pragma once

#include "instance.h"

int calibration_close(Instance *i, const double *there, const double *v, double *near);
void calibration_find(Instance *i, const double *q, const double *v, const unsigned char *held, int usual);
