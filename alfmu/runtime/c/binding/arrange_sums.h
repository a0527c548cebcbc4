/* Finds sums of products in a function. */

#ifndef ALFMU_ARRANGE_SUMS_H
#define ALFMU_ARRANGE_SUMS_H

#include "arrange_operations.h"

#include "internal_begin.h"

/* A function while its sums are found. */
typedef struct {
    Room room;
    int count;
    const int *codes, *first, *second, *opposite;
    int *uses;
    int terms, *negative, *factor, *other, *next;
    /* Summands: a value (`linear_factor`), or a product of two, and the one that is added after it; -1 for none. */
    int *begin, *end, *length;
    /* Data of each sum; a length of zero means that there is none. */
    int *negatives, *constants, values;
    Operations made;
} Sums;

void arrange_sums(Sums *f);
void without_differences(Sums *f);
void arrange_write(Sums *f, int k);

#include "internal_end.h"

#endif
