/* Finds redundant constraints that contradict each other. */

#pragma once

#include "instance.h"

Outcome agreement_check(
    Instance *i, const unsigned char *held, const double *q, const double *v, const double *open);
void agreement_warn_of_second_order(Instance *i, const unsigned char *held, const double *q);
