/* Finds sums of products in a function. */

#pragma once

#include "arrange_operations.h"

/* A function whose sums are being found. */
typedef struct {
    Room room;
    int count;
    const int *codes, *first, *second, *opposite;
    int *uses;
    /* Data of summands: a value, or a product with `other`; the one added `next`; -1 for none. */
    int terms, *negative, *factor, *other, *next;
    /* Data of each sum: its first and last summand, and their number, zero for no sum. */
    int *begin, *end, *length;
    int *negatives, *constants, values;
    Operations made;
} Sums;

void arrange_sums(Sums *f);
void without_differences(Sums *f);
void arrange_write(Sums *f, int k);
