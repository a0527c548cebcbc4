/* Memory of instances from a static arena: blocks one behind another, each behind its size and whether it is taken. */

#ifndef ALFMU_MEMORY_H
#define ALFMU_MEMORY_H

#include <stddef.h>
#include <string.h>

typedef union {
    double number;
    struct {
        size_t length; /* of a block with this cell; 0 in the last one, which nothing has been taken from */
        size_t taken;
    } block;
} Cell;

static Cell cells[(ARENA * sizeof(double) + sizeof(Cell) - 1) / sizeof(Cell)];

#define CELLS (sizeof cells / sizeof *cells)

static size_t block_length(size_t at)
{
    return cells[at].block.length ? cells[at].block.length : CELLS - at;
}

/* Memory that is zero, to be given back; NULL where there is none. */
static void *memory_take(size_t count, size_t size)
{
    const size_t wanted = 1 + (count * size + sizeof(Cell) - 1) / sizeof(Cell);
    for (size_t at = 0, length; at < CELLS; at += length) {
        length = block_length(at);
        if (cells[at].block.taken)
            continue;
        while (at + length < CELLS && !cells[at + length].block.taken) /* Free blocks join. */
            length += block_length(at + length);
        cells[at].block.length = length;
        if (length < wanted)
            continue;
        if (length > wanted) {
            cells[at + wanted].block.length = length - wanted;
            cells[at + wanted].block.taken = 0;
        }
        cells[at].block.length = wanted;
        cells[at].block.taken = 1;
        return memset(cells + at + 1, 0, (wanted - 1) * sizeof(Cell));
    }
    return NULL;
}

static void memory_give(void *given)
{
    if (given)
        ((Cell *)given - 1)->block.taken = 0;
}

#endif
