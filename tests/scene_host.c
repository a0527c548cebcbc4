/* Functions of a scene for the tests of tests/test_scene.py: as a library it loads scenes and calls their functions; as a
   program it damages the scene of a file in every place, and what is not refused then must run within its memory. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "instance.h"
#include "interpret.h"
#include "lanes.h"
#include "operations.h"

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
#define MOST_ROOM (1 << 22) /* numbers of a damaged scene that are tried */

EXPORT Scene *host_load(const unsigned char *bytes, size_t size, char *why, size_t why_size);
EXPORT void host_free(Scene *s);
EXPORT int host_replace(Scene *s, Compiled *const *functions, int count, int spare, const char *identity);
EXPORT int host_shape(const Scene *s, int which, int *wide);
EXPORT int host_call(const Scene *s, int which, const double *x, double *y);
EXPORT int host_length(const Scene *s);
EXPORT int host_run(const Scene *s, int quick, double *m);

Scene *host_load(const unsigned char *bytes, size_t size, char *why, size_t why_size)
{
    return scene_load(bytes, size, why, why_size);
}

void host_free(Scene *s)
{
    scene_free(s);
}

int host_replace(Scene *s, Compiled *const *functions, int count, int spare, const char *identity)
{
    return scene_compiled(s, functions, count, spare, identity, 0);
}

/* How many functions there are, and whether the places of one have 32 bits. */
int host_shape(const Scene *s, int which, int *wide)
{
    *wide = s->functions[which].wide != NULL;
    return s->function_count;
}

/* What functions and programs need of an instance, each in memory of its own, so that a sanitizer sees its ends. */
static int made(Instance *i, const Scene *s)
{
    double *room;
    memset(i, 0, sizeof *i);
    i->scene = s;
    i->registers = malloc((size_t)s->registers * sizeof(double) + 1);
    room = malloc(LANES * ((size_t)s->lane_registers + 1) * sizeof(double));
    i->lanes = room ? lanes_align(room) : NULL;
    i->before = room; /* which nothing here has a use for */
    i->spare = malloc((size_t)s->spare * sizeof(double) + 1);
    i->m = calloc((size_t)s->size + (size_t)s->workspace + 1, sizeof(double));
    if (i->registers && room)
        registers_load(i);
    return i->registers && room && i->spare && i->m;
}

static void unmade(Instance *i)
{
    free(i->registers);
    free(i->before);
    free(i->spare);
    free(i->m);
}

/* Arguments and results follow each other. */
int host_call(const Scene *s, int which, const double *x, double *y)
{
    const Function *f = s->functions + which;
    const double *arguments[MOST_ARGUMENTS];
    double *results[MOST_ARGUMENTS];
    Instance i;
    const int done = made(&i, s);
    for (int k = 0; k < f->inputs; x += f->lengths[k++])
        arguments[k] = x;
    for (int k = 0; k < f->outputs; y += f->lengths[f->inputs + k++])
        results[k] = y;
    if (done)
        function_call(&i, which, arguments, results);
    unmade(&i);
    return done;
}

/* Numbers of a memory and of the workspace behind it. */
int host_length(const Scene *s)
{
    return s->size + s->workspace;
}

/* The quick step, or what is read at an instant, on a memory and its workspace. */
int host_run(const Scene *s, int quick, double *m)
{
    Instance i;
    const int done = made(&i, s);
    if (done) {
        memcpy(i.m, m, (size_t)host_length(s) * sizeof *m);
        program_run(&i, quick ? s->quick : s->instant);
        memcpy(m, i.m, (size_t)host_length(s) * sizeof *m);
    }
    unmade(&i);
    return done;
}

/* Damage ----------------------------------------------------------------------------------------------------------- */

static void put(unsigned char *at, uint64_t value, int bytes)
{
    for (int k = 0; k < bytes; k++)
        at[k] = (unsigned char)(value >> 8 * k);
}

/* The check sum that a file of this content has, so that what is behind it has to notice damage. */
static void signed_again(unsigned char *bytes, size_t size)
{
    put(bytes + 12, size, 4);
    put(bytes + 16, (uint32_t)~scene_check_sum(CHECK_BEGIN, bytes + 24, size - 24), 8);
}

static long refused, taken_anyway;

/* Loads a scene; what is taken runs all its functions, and its quick step in lanes. Returns whether it was. */
static int tried(const unsigned char *bytes, size_t size)
{
    char why[200] = "";
    unsigned char *own = malloc(size + !size); /* of this size, so that a sanitizer sees its end */
    Scene *s;
    if (!own)
        abort();
    memcpy(own, bytes, size);
    s = scene_load(own, size, why, sizeof why);
    free(own);
    if (!s) {
        refused++;
        if (!*why) {
            printf("refused without a reason\n");
            exit(1);
        }
        return 0;
    }
    taken_anyway++;
    for (int which = 0; which < s->function_count; which++) {
        const Function *f = s->functions + which;
        size_t in = 0, out = 0;
        double *x, *y;
        for (int k = 0; k < f->inputs + f->outputs; k++)
            *(k < f->inputs ? &in : &out) += (size_t)f->lengths[k];
        if (in > MOST_ROOM || out > MOST_ROOM || s->registers > MOST_ROOM || s->size + s->workspace > MOST_ROOM)
            continue;
        x = calloc(in + 1, sizeof *x);
        y = calloc(out + 1, sizeof *y);
        if (x && y)
            host_call(s, which, x, y);
        free(x);
        free(y);
    }
    /* One that begins with calls in lanes; loops could take for ever. */
    if (s->quick >= 0 && s->programs[s->quick].words && s->programs[s->quick].code[0] == LANES_CODE
        && s->registers <= MOST_ROOM && s->lane_registers <= MOST_ROOM / LANES && s->size + s->workspace <= MOST_ROOM) {
        Instance i;
        if (made(&i, s))
            program_run(&i, s->quick);
        unmade(&i);
    }
    scene_free(s);
    return 1;
}

int main(int count, char **arguments)
{
    FILE *file = count == 3 ? fopen(arguments[1], "rb") : NULL;
    const size_t whole = count == 3 ? (size_t)atol(arguments[2]) : 0; /* what is a scene without what stands behind it */
    static unsigned char bytes[1 << 20], other[1 << 20];
    const size_t size = file ? fread(bytes, 1, sizeof bytes, file) : 0;
    if (!size || size == sizeof bytes || !tried(bytes, size)) {
        printf("there is no whole scene\n");
        return 1;
    }
    fclose(file);
    /* Without another check sum all damage is seen. */
    for (size_t k = 0; k < size; k++) {
        memcpy(other, bytes, size);
        other[k] ^= (unsigned char)(1u << k % 8);
        if (tried(other, size)) {
            printf("byte %zu may be changed\n", k);
            return 1;
        }
        if (tried(bytes, k)) {
            printf("the first %zu bytes are enough\n", k);
            return 1;
        }
    }
    for (size_t k = 64; k < size; k++) {
        memcpy(other, bytes, k);
        signed_again(other, k);
        if (tried(other, k) != (k == whole)) {
            printf("the first %zu bytes are enough\n", k);
            return 1;
        }
    }
    /* With it, what is taken must be within its memory. */
    for (size_t k = 64; k < size; k++)
        for (int change = 0; change < 4; change++) {
            const uint64_t word = k + 4 <= size ? (uint64_t)bytes[k] | (uint64_t)bytes[k + 1] << 8 : 0;
            memcpy(other, bytes, size);
            if (change == 0)
                other[k] ^= (unsigned char)(1u << k % 8);
            else if (k + 4 > size)
                continue;
            else if (change == 1)
                put(other + k, 0xffffffffu, 4);
            else if (change == 2)
                put(other + k, 0x7fffffffu, 4);
            else
                put(other + k, word + 1, 2);
            signed_again(other, size);
            tried(other, size);
        }
    printf("%ld refused, %ld taken\n", refused, taken_anyway);
    return 0;
}
