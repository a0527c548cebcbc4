/* Reads the numbers and texts of a scene file; keeps the first error. */

#pragma once

#include "scene.h"

typedef struct {
    const unsigned char *at, *end;
    Scene *scene;
    char *why;
    size_t why_size;
    int bad;
    int64_t results; /* of all functions so far */
} Reader;

struct Block {
    struct Block *next;
};

void reader_spoil(Reader *r, const char *format, ...);
void *reader_alloc(Reader *r, size_t count, size_t size);
uint64_t bytes_little(const unsigned char *at, int bytes);
int reader_has(Reader *r, size_t count, size_t bytes);
int32_t reader_integer(Reader *r);
int32_t reader_bare(Reader *r);
double reader_real(Reader *r);
size_t reader_length(Reader *r);
const char *reader_text(Reader *r);
int32_t *reader_integers(Reader *r, int count, size_t *found);
double *reader_reals(Reader *r, size_t *found);
const int *reader_places(Reader *r, int count, int least, int end, const char *what);
int reader_check_between(int value, int least, int end);
