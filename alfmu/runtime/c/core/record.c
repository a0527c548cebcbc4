/* The tape: a record of all that a run computes, from which it is differentiated. */

#include "record.h"

#include <stdlib.h>

#include "instance.h"
#include "scene.h"

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

/* Double the room of an array until it suffices; return 0 if there is no memory. */
static int widen_array(void **array, size_t *room, size_t needed, size_t each)
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
    t->lost = !(widen_array((void **)&t->entries, &t->room.entries, t->used.entries + 1, sizeof *t->entries)
        && widen_array((void **)&t->words, &t->room.words, t->used.words + words, sizeof *t->words)
        && widen_array((void **)&t->numbers, &t->room.numbers, t->used.numbers + numbers, sizeof *t->numbers));
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

void tape_begin_reading(Instance *i)
{
    if (i->tape)
        i->tape->reading = i->tape->used;
}

int tape_pause(Instance *i, int paused)
{
    const int before = i->tape ? i->tape->paused : 0;
    if (i->tape)
        i->tape->paused = paused;
    return before;
}

/* Return whether a place of the memory has no derivative: step size, step control, tallies, and settings except the
   penalties of a frozen rank, which come last. */
static int has_no_derivative(const Scene *s, ptrdiff_t in_memory)
{
    return in_memory >= (s->brakes ? s->dt : s->k) && in_memory < s->past;
}

int32_t tape_place_of(const Instance *i, const double *number)
{
    const ptrdiff_t place = number - i->numbers, end = i->scratch + i->room - i->numbers;
    if (number < i->numbers || place >= end || has_no_derivative(i->scene, number - i->m))
        return -1;
    return (int32_t)place;
}

void tape_call_at(Instance *i, const Function *f, const Word *at)
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
        words[j] = has_no_derivative(s, at[j]) ? -1 : (int32_t)(at[j] + base);
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
        words[j] = tape_place_of(i, x[j]);
        memcpy(saved, x[j], (size_t)f->lengths[j] * sizeof *saved);
    }
    for (int j = 0; j < f->outputs; j++)
        words[f->inputs + j] = tape_place_of(i, y[j]);
}

void tape_copy(Instance *i, const double *to, const double *from, size_t count)
{
    Entry *e = count ? tape_entry(i, COPIED, 0, 3, 0) : NULL;
    int32_t *words;
    if (!e)
        return;
    words = i->tape->words + e->words;
    words[0] = tape_place_of(i, to);
    words[1] = tape_place_of(i, from);
    words[2] = (int32_t)count;
}

void tape_clearing(Instance *i, const double *to, size_t count)
{
    Entry *e = count ? tape_entry(i, CLEARED, 0, 2, 0) : NULL;
    if (!e)
        return;
    i->tape->words[e->words] = tape_place_of(i, to);
    i->tape->words[e->words + 1] = (int32_t)count;
}

void tape_sum(Instance *i, const double *to, int terms, const double *const *from, const double *by)
{
    Entry *e = tape_entry(i, COMBINED, terms, (size_t)terms + 1, (size_t)terms);
    if (!e)
        return;
    i->tape->words[e->words] = tape_place_of(i, to);
    for (int k = 0; k < terms; k++) {
        i->tape->words[e->words + 1 + (size_t)k] = tape_place_of(i, from[k]);
        i->tape->numbers[e->numbers + (size_t)k] = by[k];
    }
}

/* Copy the latest factors to `kept`, after the numbers of the newest entry; return their index. */
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
    words[3] = tape_place_of(i, weights);
    memcpy(numbers, weights, own * sizeof *numbers);
    numbers += own;
    for (int j = 0; j < count; j++, numbers += part) {
        words[4 + j] = tape_place_of(i, parts[j]);
        memcpy(numbers, parts[j], part * sizeof *numbers);
    }
    words[4 + count] = t->factors = tape_place_of(i, factors);
    t->factors_kept = keep_factors(t, numbers, factors, order, size);
}

void tape_solve(Instance *i, int n, int blocks, const double *factors, const double *order, const double *const *right,
    const double *x)
{
    const size_t size = (size_t)(n * blocks);
    const int known = i->tape && i->tape->factors == tape_place_of(i, factors);
    Entry *e = tape_entry(i, SOLVED, 0, (size_t)(6 + blocks), size + (known ? 0 : size * size + size));
    Tape *t = i->tape;
    size_t kept;
    int32_t *words;
    if (!e)
        return;
    words = t->words + e->words;
    words[0] = n;
    words[1] = blocks;
    words[2] = tape_place_of(i, factors);
    for (int j = 0; j < blocks; j++)
        words[3 + j] = tape_place_of(i, right[j]);
    words[3 + blocks] = tape_place_of(i, x);
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
        i->tape->words[e->words + 1 + (size_t)k] = tape_place_of(i, from[k]);
        memcpy(numbers, from[k], count * sizeof *numbers);
        numbers += count;
    }
}

size_t arguments_of(const Function *f)
{
    size_t count = 0;
    for (int j = 0; j < f->inputs; j++)
        count += (size_t)f->lengths[j];
    return count;
}

static double *tape_saved_arguments(const Function *f, const double *const *x, double *to)
{
    for (int j = 0; j < f->inputs; to += f->lengths[j++])
        memcpy(to, x[j], (size_t)f->lengths[j] * sizeof *to);
    return to;
}

void tape_correction(Instance *i, const double *rows, const double *columns, const double *q, const double *v,
    const double *x, const double *lam, double part)
{
    const Scene *s = i->scene;
    const Function *closure = s->functions + s->closure, *constraints = s->functions + s->constraints;
    const size_t n = (size_t)s->n, count = (size_t)(s->l + s->ties);
    const double *p = instance_field(i, s->p), *starts = i->values + s->own, *rates = starts + s->starts;
    const double *of_closure[] = {q, p, starts}, *of_constraints[] = {q, v, p};
    const double *places[] = {q, p, starts, v, rates};
    const size_t numbers = arguments_of(closure) + (v ? arguments_of(constraints) : 0) + 2 * (n + count) + 1;
    Entry *e = count ? tape_entry(i, v ? RATED : CLOSED, 0, PLACE_COUNT, numbers) : NULL;
    double *to;
    if (!e)
        return;
    for (int k = 0; k < PLACE_COUNT; k++)
        i->tape->words[e->words + (size_t)k] = places[k] ? tape_place_of(i, places[k]) : -1;
    to = tape_saved_arguments(closure, of_closure, i->tape->numbers + e->numbers);
    if (v)
        to = tape_saved_arguments(constraints, of_constraints, to);
    memcpy(to, rows, count * sizeof *to);
    memcpy(to + count, columns, n * sizeof *to);
    to += count + n;
    memset(to, 0, (n + count) * sizeof *to);
    if (x) {
        memcpy(to, x, n * sizeof *to);
        memcpy(to + n, lam, count * sizeof *to);
    }
    to[n + count] = part;
}

/* S5: record a frozen rank. With A = C' sqrt(penalty), its right singular vectors v, sizes s and b = A v, the kept
   combinations have the projector P = sum v v', whose differential is the sum over each kept k and each other j of (v_j
   v_k' + v_k v_j') (b_k' dA v_j + b_j' dA v_k) / (s_k^2 - s_j^2). */

void tape_holding(Instance *i, const double *q, const double *matrix)
{
    const Scene *s = i->scene;
    const Function *f = s->functions + s->constraints;
    const size_t arena = arena_mark(i), l = (size_t)s->l;
    double *zeros = arena_alloc(i, (size_t)s->n), *to;
    const double *p = instance_field(i, s->p), *x[] = {q, zeros, p};
    Entry *e = tape_entry(i, HELD, (int)*i->rank, 3, arguments_of(f) + l + 1);
    if (e) {
        memset(zeros, 0, (size_t)s->n * sizeof *zeros);
        i->tape->words[e->words] = tape_place_of(i, q);
        i->tape->words[e->words + 1] = tape_place_of(i, p);
        i->tape->words[e->words + 2] = tape_place_of(i, matrix);
        to = tape_saved_arguments(f, x, i->tape->numbers + e->numbers);
        memcpy(to, i->penalty, l * sizeof *to);
        to[l] = *i->largest_penalty;
    }
    arena_release(i, arena);
}
