/* Values and partial derivatives of the operations that scenes seldom use. */

#pragma once

/* Value of a rare operation for its operands a and b, and its partial derivatives. */
double operation_value(int kind, double a, double b);

void operation_partials(int kind, double a, double b, double of[2]);
