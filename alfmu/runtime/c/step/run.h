/* Communication steps, from the checks before a step to the outputs after it. */

#pragma once

#include "instance.h"

Outcome instance_can_step(Instance *i, double start, double h);
Outcome instance_ready(Instance *i, double start, double h);
Outcome instance_step(Instance *i, double start, double h);
Outcome instance_output_derivatives(
    Instance *i, const unsigned *references, const int *orders, size_t count, double *values);
