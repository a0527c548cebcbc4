/* Arranges a function for the interpreter. */

#ifndef ALFMU_ARRANGE_H
#define ALFMU_ARRANGE_H

#include "fmi.h"

API int alfmu_arrange(int count, const int *codes, const int *operands, const int *opposite, int constant_count,
    int *constants, int *heads, int *operands_then, int *made_then);

#endif
