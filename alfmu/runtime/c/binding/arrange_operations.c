#include "arrange_operations.h"

#include <stdlib.h>


#define MOST_INTEGERS ((size_t)1 << 29)

/* Return an array of `count` integers that all are `value`; without memory, set `missing` and return NULL. */
int *arrange_integers(Room *room, size_t count, int value)
{
    Room_block *block = count < MOST_INTEGERS ? malloc(sizeof *block + (count + 1) * sizeof(int)) : NULL;
    if (!block) {
        room->missing = 1;
        return NULL;
    }
    int *made = (int *)(block + 1);
    block->before = room->last;
    room->last = block;
    for (size_t k = 0; k < count; k++)
        made[k] = value;
    return made;
}

void arrange_leave(Room *room)
{
    while (room->last) {
        Room_block *before = room->last->before;
        free(room->last);
        room->last = before;
    }
}

int arrange_less(const int a[3], const int b[3])
{
    return a[0] != b[0] ? a[0] < b[0] : a[1] != b[1] ? a[1] < b[1] : a[2] < b[2];
}

static void swap(int a[3], int b[3])
{
    for (int k = 0; k < 3; k++) {
        int kept = a[k];
        a[k] = b[k];
        b[k] = kept;
    }
}

void arrange_push(Heap *heap, int first, int second, int third)
{
    int at = heap->count++;
    heap->entries[at][0] = first;
    heap->entries[at][1] = second;
    heap->entries[at][2] = third;
    for (; at && arrange_less(heap->entries[at], heap->entries[(at - 1) / 2]); at = (at - 1) / 2)
        swap(heap->entries[at], heap->entries[(at - 1) / 2]);
}

void arrange_pop(Heap *heap, int taken[3])
{
    for (int k = 0; k < 3; k++)
        taken[k] = heap->entries[0][k];
    swap(heap->entries[0], heap->entries[--heap->count]);
    for (int at = 0, next; (next = 2 * at + 1) < heap->count; at = next) {
        next += next + 1 < heap->count && arrange_less(heap->entries[next + 1], heap->entries[next]);
        if (!arrange_less(heap->entries[next], heap->entries[at]))
            break;
        swap(heap->entries[at], heap->entries[next]);
    }
}

void arrange_add(Operations *o, int kind, int made, int other)
{
    o->kinds[o->count] = kind;
    o->begins[o->count] = o->used;
    o->made[o->count][0] = made;
    o->made[o->count++][1] = other;
    o->used += OPERANDS[kind];
}
