/* Arranges a function for the interpreter. */

#pragma once

#include "fmi.h"

API int alfmu_arrange(int count, const int *codes, const int *operands, const int *opposite, int constant_count,
    int *constants, int *heads, int *operands_then, int *made_then);
