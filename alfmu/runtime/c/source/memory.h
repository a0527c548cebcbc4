/* Memory of instances from a static arena. Each block follows its length, which is negative while it is in use. */

#pragma once

#include <stddef.h>
#include <string.h>

typedef union {
    double number;
    ptrdiff_t length;
} Cell;

static Cell cells[ARENA * sizeof(double) / sizeof(Cell) + 1];

/* Allocate zeroed memory; return NULL if there is none. */
static void *memory_take(size_t count, size_t size)
{
    const ptrdiff_t all = (ptrdiff_t)(sizeof cells / sizeof *cells);
    const ptrdiff_t wanted = 1 + (ptrdiff_t)((count * size + sizeof(Cell) - 1) / sizeof(Cell));
    if (!cells[0].length)
        cells[0].length = all;
    for (ptrdiff_t at = 0, next; at < all; at = next) {
        next = at + (cells[at].length < 0 ? -cells[at].length : cells[at].length);
        if (cells[at].length < 0)
            continue;
        for (; next < all && cells[next].length > 0; next += cells[next].length)
            cells[at].length += cells[next].length; /* Merge free blocks. */
        if (cells[at].length < wanted)
            continue;
        if (cells[at].length > wanted)
            cells[at + wanted].length = cells[at].length - wanted;
        cells[at].length = -wanted;
        return memset(cells + at + 1, 0, (size_t)(wanted - 1) * sizeof(Cell));
    }
    return NULL;
}

static void memory_give(void *given)
{
    if (given)
        ((Cell *)given)[-1].length *= -1;
}
