/* Values and partial derivatives of the operations that scenes seldom use. */

#ifndef ALFMU_RARE_OPERATIONS_H
#define ALFMU_RARE_OPERATIONS_H

/* Value of a rare operation for its operands a and b, and its partial derivatives. */
double operation_value(int kind, double a, double b);

void operation_partials(int kind, double a, double b, double of[2]);

#endif
