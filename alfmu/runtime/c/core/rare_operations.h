/* Values and partial derivatives of the operations that scenes seldom use. */

#ifndef ALFMU_RARE_OPERATIONS_H
#define ALFMU_RARE_OPERATIONS_H

#include "internal_begin.h"

/* What a rare operation gives for its operands a and b, and its derivatives by them. */
double operation_value(int kind, double a, double b);

void operation_partials(int kind, double a, double b, double of[2]);

#include "internal_end.h"

#endif
