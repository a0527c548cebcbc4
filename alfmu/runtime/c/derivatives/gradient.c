#include "gradient.h"

#include <stdlib.h>

#include "instance.h"
#include "interpret.h"
#include "lanes.h"
#include "operations.h"
#include "record.h"
#include "scene.h"

static const unsigned char operand_counts[] = {OPERAND_COUNTS, 1};

#define COPY_KIND KIND_COUNT /* a copy, in a flat function */

/* State of a traversal that first counts the entries of a flat function, and then writes them. */
typedef struct {
    Flat *flat;
    size_t runs, operands;
    int32_t result;
    int writes;
} Writing;

static int32_t *run_begin(Writing *w, int32_t kind, int32_t count)
{
    int32_t *operands = w->writes ? w->flat->operands + w->operands : NULL;
    if (w->writes)
        w->flat->runs[w->runs] = (Run_of){kind, count, w->result, operands};
    w->runs++;
    w->operands += (size_t)count * operand_counts[kind];
    w->result += count * (kind == COPY_KIND ? 1 : VALUES_OF(kind));
    return operands;
}

static void write_pass(Writing *w, const int32_t *at, const int32_t *end, int32_t pass)
{
    while (at < end) {
        const int32_t kind = *at++, count = *at++, operands = operand_counts[kind];
        int32_t *into = run_begin(w, kind, count);
        for (int32_t k = 0; k < count * operands; k++, at += 2)
            if (into)
                *into++ = at[0] + pass * at[1];
    }
}

static void write_wide(Writing *w, const int32_t *at, const int32_t *end)
{
    while (at < end) {
        const int32_t kind = *at++, count = *at++;
        int32_t *into;
        if (kind == LOOP_KIND) {
            const int32_t body = at[1];
            at += 2;
            for (int32_t pass = 0; pass < count; pass++)
                write_pass(w, at, at + body, pass);
            at += body;
        } else if (kind == EACH_KIND) {
            const int32_t each = *at++, operands = operand_counts[each];
            into = run_begin(w, each, count);
            for (int32_t pass = 0; into && pass < count; pass++)
                for (int32_t k = 0; k < operands; k++)
                    *into++ = at[2 * k] + pass * at[2 * k + 1];
            at += 2 * operands;
        } else {
            const int32_t known = kind == GATHER_KIND ? COPY_KIND : kind, words = count * operand_counts[known];
            into = run_begin(w, known, count);
            for (int32_t k = 0; into && k < words; k++)
                into[k] = at[k];
            at += words;
        }
    }
}

static void write_narrow(Writing *w, const uint16_t *at, const uint16_t *end)
{
    while (at < end) {
        const int32_t kind = at[0], count = at[1], words = count * operand_counts[kind];
        int32_t *into = run_begin(w, kind, count);
        at += NARROW_HEAD;
        for (int32_t k = 0; into && k < words; k++)
            into[k] = at[k];
        at += words;
    }
}

const Flat *gradient_flat(Gradient *g, int which)
{
    const Function *f = g->instance->scene->functions + which;
    Flat *flat = g->flats + which;
    if (flat->runs)
        return flat;
    flat->first = g->instance->scene->constant_count;
    for (int j = 0; j < f->inputs; j++)
        flat->first += f->lengths[j];
    flat->registers = f->registers;
    for (int writes = 0; writes < 2; writes++) {
        Writing w = {flat, 0, 0, flat->first, writes};
        if (f->narrow)
            write_narrow(&w, f->narrow, f->narrow + f->words);
        else
            write_wide(&w, f->wide, f->wide + f->words);
        flat->count = (int)w.runs;
        if (!writes) {
            flat->runs = malloc((w.runs + 1) * sizeof *flat->runs);
            flat->operands = malloc((w.operands + 1) * sizeof *flat->operands);
            if (!flat->runs || !flat->operands) {
                free(flat->runs);
                free(flat->operands);
                memset(flat, 0, sizeof *flat);
                g->lost = 1;
                return NULL;
            }
        }
    }
    return flat;
}

int32_t function_result_place(const Function *f, size_t k)
{
    return f->narrow ? f->narrow[f->words + k] : f->wide[f->words + k];
}

double *gradient_values_again(Gradient *g, int which, const double *saved)
{
    Instance *i = g->instance;
    const Function *f = i->scene->functions + which;
    double *r = i->registers, *d = r + i->scene->constant_count;
    size_t count = 0;
    for (int j = 0; j < f->inputs; j++)
        count += (size_t)f->lengths[j];
    memcpy(d, saved, count * sizeof *d);
    function_evaluate(f, r, d + count);
    return r;
}

Gradient *gradient_new(Instance *i, int directions)
{
    const Scene *s = i->scene;
    Gradient *g = calloc(1, sizeof *g);
    size_t lanes, registers = (size_t)s->registers;
    if (!g)
        return NULL;
    g->instance = i;
    g->functions = s->function_count;
    g->places = (size_t)(i->scratch + i->room - i->numbers);
    g->blocks = (directions + LANES - 1) / LANES;
    g->tape = tape_new();
    g->flats = calloc((size_t)s->function_count + 1, sizeof *g->flats);
    g->adjoints = calloc(g->places + registers + 1, sizeof *g->adjoints);
    lanes = (size_t)g->blocks * g->places + (g->blocks ? registers : 0) + 1;
    g->lanes_block = calloc(lanes + 1, sizeof(Lanes));
    if (!g->tape || !g->flats || !g->adjoints || !g->lanes_block) {
        gradient_free(g);
        return NULL;
    }
    g->registers = g->adjoints + g->places;
    g->tangents = (Lanes *)lanes_align(g->lanes_block);
    g->lane_registers = g->tangents + (size_t)g->blocks * g->places;
    return g;
}

void gradient_free(Gradient *g)
{
    if (!g)
        return;
    tape_free(g->tape);
    for (int k = 0; g->flats && k < g->functions; k++) {
        free(g->flats[k].runs);
        free(g->flats[k].operands);
    }
    free(g->flats);
    free(g->adjoints);
    free(g->lanes_block);
    free(g->states);
    free(g->windows);
    free(g->marks);
    free(g);
}
