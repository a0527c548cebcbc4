/* Writes down what a run does, and functions as what can be swept through in both directions. */

#include "tape.h"

#include <stdlib.h>
#include <string.h>

#include "operations.h"

#define BEGIN_ROOM 1024

Tape *tape_new(void)
{
    Tape *t = calloc(1, sizeof *t);
    if (t)
        t->factors = -1;
    return t;
}

void tape_free(Tape *t)
{
    if (t) {
        free(t->entries);
        free(t->words);
        free(t->numbers);
        free(t);
    }
}

size_t tape_bytes(const Tape *t)
{
    return t->used.entries * sizeof *t->entries + t->used.words * sizeof *t->words
        + t->used.numbers * sizeof *t->numbers;
}

void tape_clear(Tape *t)
{
    memset(&t->used, 0, sizeof t->used);
    memset(&t->reading, 0, sizeof t->reading);
    t->factors = -1;
}

/* More room, twice what there was; 0 where there is no memory. */
static int widened(void **array, size_t *room, size_t needed, size_t each)
{
    size_t wanted = *room ? *room : BEGIN_ROOM;
    void *made;
    if (needed <= *room)
        return 1;
    while (wanted < needed)
        wanted *= 2;
    made = realloc(*array, wanted * each);
    if (!made)
        return 0;
    *array = made;
    *room = wanted;
    return 1;
}

Entry *tape_entry(Instance *i, Taped kind, int what, size_t words, size_t numbers)
{
    Tape *t = i->tape;
    Entry *e;
    if (!t || t->paused || t->lost)
        return NULL;
    t->lost = !(widened((void **)&t->entries, &t->room.entries, t->used.entries + 1, sizeof *t->entries)
        && widened((void **)&t->words, &t->room.words, t->used.words + words, sizeof *t->words)
        && widened((void **)&t->numbers, &t->room.numbers, t->used.numbers + numbers, sizeof *t->numbers));
    if (t->lost)
        return NULL;
    e = t->entries + t->used.entries++;
    *e = (Entry){kind, what, t->used.words, t->used.numbers};
    t->used.words += words;
    t->used.numbers += numbers;
    return e;
}

Mark tape_mark(const Instance *i)
{
    const Mark none = {0, 0, 0};
    return i->tape ? i->tape->used : none;
}

void tape_cut(Instance *i, Mark mark)
{
    if (i->tape) {
        i->tape->used = mark;
        i->tape->factors = -1;
    }
}

int tape_pause(Instance *i, int paused)
{
    const int before = i->tape ? i->tape->paused : 0;
    if (i->tape)
        i->tape->paused = paused;
    return before;
}

/* Where what has no derivative stands in the memory: step size, step control, tallies, and settings but for what stands for
   penalties where a rank is frozen, which is the last of them. */
static int passive(const Scene *s, ptrdiff_t in_memory)
{
    return in_memory >= (s->brakes ? s->dt : s->k) && in_memory < s->past;
}

int32_t place_of(const Instance *i, const double *number)
{
    const ptrdiff_t place = number - i->numbers, end = i->scratch + i->room - i->numbers;
    if (number < i->numbers || place >= end || passive(i->scene, number - i->m))
        return -1;
    return (int32_t)place;
}

void tape_call_at(Instance *i, const Function *f, const int32_t *at)
{
    const Scene *s = i->scene;
    const ptrdiff_t base = i->m - i->numbers;
    const int each = f->inputs + f->outputs;
    size_t numbers = 0;
    int32_t *words;
    double *saved;
    Entry *e;
    for (int j = 0; j < f->inputs; j++)
        numbers += (size_t)f->lengths[j];
    e = tape_entry(i, CALLED, (int)(f - s->functions), (size_t)each, numbers);
    if (!e)
        return;
    words = i->tape->words + e->words;
    saved = i->tape->numbers + e->numbers;
    for (int j = 0; j < each; j++)
        words[j] = passive(s, at[j]) ? -1 : (int32_t)(at[j] + base);
    for (int j = 0; j < f->inputs; saved += f->lengths[j++])
        memcpy(saved, i->m + at[j], (size_t)f->lengths[j] * sizeof *saved);
}

void tape_call(Instance *i, int which, const double *const *x, double *const *y)
{
    const Function *f = i->scene->functions + which;
    size_t numbers = 0;
    int32_t *words;
    double *saved;
    Entry *e;
    for (int j = 0; j < f->inputs; j++)
        numbers += (size_t)f->lengths[j];
    e = tape_entry(i, CALLED, which, (size_t)(f->inputs + f->outputs), numbers);
    if (!e)
        return;
    words = i->tape->words + e->words;
    saved = i->tape->numbers + e->numbers;
    for (int j = 0; j < f->inputs; saved += f->lengths[j++]) {
        words[j] = place_of(i, x[j]);
        memcpy(saved, x[j], (size_t)f->lengths[j] * sizeof *saved);
    }
    for (int j = 0; j < f->outputs; j++)
        words[f->inputs + j] = place_of(i, y[j]);
}

void taped_call(Instance *i, int which, const double *const *x, double *const *y)
{
    tape_call(i, which, x, y);
    call(i, which, x, y);
}

void tape_copy(Instance *i, const double *to, const double *from, size_t count)
{
    Entry *e = count ? tape_entry(i, COPIED, 0, 3, 0) : NULL;
    int32_t *words;
    if (!e)
        return;
    words = i->tape->words + e->words;
    words[0] = place_of(i, to);
    words[1] = place_of(i, from);
    words[2] = (int32_t)count;
}

void tape_clearing(Instance *i, const double *to, size_t count)
{
    Entry *e = count ? tape_entry(i, CLEARED, 0, 2, 0) : NULL;
    if (!e)
        return;
    i->tape->words[e->words] = place_of(i, to);
    i->tape->words[e->words + 1] = (int32_t)count;
}

void tape_sum(Instance *i, const double *to, int terms, const double *const *from, const double *by)
{
    Entry *e = tape_entry(i, COMBINED, terms, (size_t)terms + 1, (size_t)terms);
    if (!e)
        return;
    i->tape->words[e->words] = place_of(i, to);
    for (int k = 0; k < terms; k++) {
        i->tape->words[e->words + 1 + (size_t)k] = place_of(i, from[k]);
        i->tape->numbers[e->numbers + (size_t)k] = by[k];
    }
}

/* The factors that were made last, behind the numbers of an entry that was just written. */
static size_t keep_factors(Tape *t, double *kept, const double *factors, const double *order, size_t size)
{
    memcpy(kept, factors, size * size * sizeof *kept);
    memcpy(kept + size * size, order, size * sizeof *kept);
    return (size_t)(kept - t->numbers);
}

void tape_factor(Instance *i, int n, int blocks, int terms, const double *weights, const double *const *parts,
    const double *factors, const double *order)
{
    const size_t size = (size_t)(n * blocks), own = (size_t)(blocks * blocks * terms), part = (size_t)(n * n);
    const int count = blocks * terms;
    Entry *e = tape_entry(i, FACTORED, 0, (size_t)(5 + count), own + (size_t)count * part + size * size + size);
    Tape *t = i->tape;
    int32_t *words;
    double *numbers;
    if (!e)
        return;
    words = t->words + e->words;
    numbers = t->numbers + e->numbers;
    words[0] = n;
    words[1] = blocks;
    words[2] = terms;
    words[3] = place_of(i, weights);
    memcpy(numbers, weights, own * sizeof *numbers);
    numbers += own;
    for (int j = 0; j < count; j++, numbers += part) {
        words[4 + j] = place_of(i, parts[j]);
        memcpy(numbers, parts[j], part * sizeof *numbers);
    }
    words[4 + count] = t->factors = place_of(i, factors);
    t->factors_kept = keep_factors(t, numbers, factors, order, size);
}

void tape_solve(Instance *i, int n, int blocks, const double *factors, const double *order, const double *const *right,
    const double *x)
{
    const size_t size = (size_t)(n * blocks);
    const int known = i->tape && i->tape->factors == place_of(i, factors);
    Entry *e = tape_entry(i, SOLVED, 0, (size_t)(6 + blocks), size + (known ? 0 : size * size + size));
    Tape *t = i->tape;
    size_t kept;
    int32_t *words;
    if (!e)
        return;
    words = t->words + e->words;
    words[0] = n;
    words[1] = blocks;
    words[2] = place_of(i, factors);
    for (int j = 0; j < blocks; j++)
        words[3 + j] = place_of(i, right[j]);
    words[3 + blocks] = place_of(i, x);
    memcpy(t->numbers + e->numbers, x, size * sizeof *x);
    kept = known ? t->factors_kept : keep_factors(t, t->numbers + e->numbers + size, factors, order, size);
    words[4 + blocks] = (int32_t)(kept & 0x7fffffff);
    words[5 + blocks] = (int32_t)(kept >> 31);
}

void tape_least_norm(Instance *i, int side, const double *matrix, const double *right, const double *x)
{
    const size_t size = (size_t)side;
    Entry *e = tape_entry(i, LEAST_NORMED, 0, 4, size * size + 2 * size);
    const double *from[] = {matrix, right, x};
    double *numbers;
    if (!e)
        return;
    i->tape->words[e->words] = side;
    numbers = i->tape->numbers + e->numbers;
    for (int k = 0; k < 3; k++) {
        const size_t count = k ? size : size * size;
        i->tape->words[e->words + 1 + (size_t)k] = place_of(i, from[k]);
        memcpy(numbers, from[k], count * sizeof *numbers);
        numbers += count;
    }
}

/* Functions written out ------------------------------------------------------------------------------------------- */

static const unsigned char operand_counts[] = {OPERAND_COUNTS, 1};

#define COPY_KIND KIND_COUNT /* of a flat function: a value as it is */

/* A flat function that is being counted, and then written. */
typedef struct {
    Flat *flat;
    size_t runs, operands;
    int32_t result;
    int writes;
} Writing;

static int32_t *begin_run(Writing *w, int32_t kind, int32_t count)
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
        int32_t *into = begin_run(w, kind, count);
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
            into = begin_run(w, each, count);
            for (int32_t pass = 0; into && pass < count; pass++)
                for (int32_t k = 0; k < operands; k++)
                    *into++ = at[2 * k] + pass * at[2 * k + 1];
            at += 2 * operands;
        } else {
            const int32_t known = kind == GATHER_KIND ? COPY_KIND : kind, words = count * operand_counts[known];
            into = begin_run(w, known, count);
            for (int32_t k = 0; into && k < words; k++)
                into[k] = at[k];
            at += words;
        }
    }
}

static void write_narrow(Writing *w, const uint16_t *at, const uint16_t *end)
{
    while (at < end) {
        const int32_t kind = *at++, count = *at++, words = count * operand_counts[kind];
        int32_t *into = begin_run(w, kind, count);
        for (int32_t k = 0; into && k < words; k++)
            into[k] = at[k];
        at += words;
    }
}

const Flat *flat_of(Gradient *g, int which)
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

int32_t result_of(const Function *f, size_t k)
{
    return f->narrow ? f->narrow[f->words + k] : f->wide[f->words + k];
}

double *values_again(Gradient *g, int which, const double *saved)
{
    Instance *i = g->instance;
    const Function *f = i->scene->functions + which;
    double *r = i->registers, *d = r + i->scene->constant_count;
    size_t count = 0;
    for (int j = 0; j < f->inputs; j++)
        count += (size_t)f->lengths[j];
    memcpy(d, saved, count * sizeof *d);
    evaluate(f, r, d + count);
    return r;
}

/* The context --------------------------------------------------------------------------------------------------------- */

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
    g->tangents = (Lanes *)lanes_from(g->lanes_block);
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
