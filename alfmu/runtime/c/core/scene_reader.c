#include "scene_reader.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

void reader_spoil(Reader *r, const char *format, ...)
{
    va_list arguments;
    if (r->bad)
        return;
    r->bad = 1;
    va_start(arguments, format);
    vsnprintf(r->why, r->why_size, format, arguments);
    va_end(arguments);
}

/* Allocate zeroed memory of the scene; if it returns NULL, `bad` is set. */
void *reader_alloc(Reader *r, size_t count, size_t size)
{
    struct Block *block;
    if (r->bad || count > SIZE_MAX / 2 / size || !(block = calloc(1, sizeof(double) + count * size))) {
        reader_spoil(r, "there is not enough memory for it");
        return NULL;
    }
    block->next = r->scene->blocks;
    r->scene->blocks = block;
    return (char *)block + sizeof(double);
}

uint64_t bytes_little(const unsigned char *at, int bytes)
{
    uint64_t value = 0;
    for (int k = bytes; k--;)
        value = value << 8 | at[k];
    return value;
}

/* Return whether the file is long enough for `count` items of some bytes each, before memory is allocated for them. */
int reader_has(Reader *r, size_t count, size_t bytes)
{
    if (count > (size_t)(r->end - r->at) / bytes)
        reader_spoil(r, "it ends too early");
    return !r->bad;
}

/* Return the next count * size bytes; NULL if there are fewer. */
static const unsigned char *reader_little(Reader *r, size_t count, size_t size)
{
    const unsigned char *at = r->at;
    if (r->bad || count > (size_t)(r->end - at) / size) {
        reader_spoil(r, "it ends too early");
        return NULL;
    }
    r->at += count * size;
    return at;
}

int32_t reader_integer(Reader *r)
{
    const unsigned char *at = reader_little(r, 1, 4);
    return at ? (int32_t)(uint32_t)bytes_little(at, 4) : 0;
}

/* Read an integer of one to five bytes of seven bits, the highest ones first; its sign is the lowest bit. */
int32_t reader_bare(Reader *r)
{
    uint32_t value = 0;
    const unsigned char *at;
    do {
        at = reader_little(r, 1, 1);
        value = value << 7 | (at ? *at & 127u : 0);
    } while (at && *at & 128);
    return (int32_t)(value >> 1 ^ (0u - (value & 1u)));
}

double reader_real(Reader *r)
{
    const unsigned char *at = reader_little(r, 1, 8);
    const uint64_t bits = at ? bytes_little(at, 8) : 0;
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

size_t reader_length(Reader *r)
{
    const int32_t count = reader_integer(r);
    if (count < 0)
        reader_spoil(r, "a list has %d entries", (int)count);
    return r->bad ? 0 : (size_t)count;
}

const char *reader_text(Reader *r)
{
    const size_t count = reader_length(r);
    const unsigned char *at = reader_little(r, count, 1);
    char *made = at ? reader_alloc(r, count + 1, 1) : NULL;
    if (!made)
        return "";
    memcpy(made, at, count);
    return made;
}

/* Read integers and their number, which must be `count` unless that is -1. */
int32_t *reader_integers(Reader *r, int count, size_t *found)
{
    const size_t size = reader_length(r);
    int32_t *made = reader_has(r, size, 1) ? reader_alloc(r, size + 1, sizeof *made) : NULL;
    if (count >= 0 && size != (size_t)count)
        reader_spoil(r, "a list has %zu entries instead of %d", size, count);
    if (!made || r->bad)
        return NULL;
    for (size_t k = 0; k < size; k++)
        made[k] = reader_bare(r);
    if (found)
        *found = size;
    return made;
}

double *reader_reals(Reader *r, size_t *found)
{
    const size_t size = reader_length(r);
    const unsigned char *at = reader_little(r, size, 8);
    double *made = at ? reader_alloc(r, size + 1, sizeof *made) : NULL;
    if (!made)
        return NULL;
    for (size_t k = 0; k < size; k++) {
        const uint64_t bits = bytes_little(at + 8 * k, 8);
        memcpy(made + k, &bits, sizeof bits);
    }
    *found = size;
    return made;
}

/* Read integers that are indices, from `least` to below `end`. */
const int *reader_places(Reader *r, int count, int least, int end, const char *what)
{
    const int32_t *made = reader_integers(r, count, NULL);
    for (int k = 0; made && k < count; k++)
        if (made[k] < least || made[k] >= end)
            reader_spoil(r, "%s %d is %d", what, k, (int)made[k]);
    return made;
}

int reader_check_between(int value, int least, int end)
{
    return value >= least && value < end;
}
