/* Lists of operations, and the arrays and heaps that arranging needs. */

#pragma once

#include "baseline.h"
#include "operations.h"

/* Arrays that are freed together. */
typedef struct Room_block {
    struct Room_block *before;
} Room_block;

typedef struct {
    Room_block *last;
    int missing;
} Room;

/* A heap of triples of integers, the least on top. */
typedef struct {
    int (*entries)[3];
    int count;
} Heap;

static const int OPERANDS[] = {OPERAND_COUNTS};

/* Operations on numbered values: where the operands of each begin, and the one or two values that it makes. */
typedef struct {
    int count, used;
    int *kinds, *begins, *operands, (*made)[2];
} Operations;

int *arrange_integers(Room *room, size_t count, int value);
void arrange_leave(Room *room);
int arrange_less(const int a[3], const int b[3]);
void arrange_push(Heap *heap, int first, int second, int third);
void arrange_pop(Heap *heap, int taken[3]);
void arrange_add(Operations *o, int kind, int made, int other);
