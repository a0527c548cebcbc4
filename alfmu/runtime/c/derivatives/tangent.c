/* Propagates tangents along a tape, LANES directions at once. Operations are differentiated by partial derivatives from
   CasADi (operations.h), routines of linear algebra by the equation that their result satisfies, with the recorded
   pivots and ranks. Operands with zero tangents are skipped, so that an infinite partial derivative in a branch not
   taken has no effect. */

#include "tangent.h"

#include "function_tangents.h"
#include "gradient.h"
#include "input_derivatives.h"
#include "instance.h"
#include "lanes.h"
#include "linear.h"
#include "record.h"
#include "scene.h"
#include "start_derivatives.h"

static void tangent_of_call(Gradient *g, const Entry *e, Lanes *t)
{
    const Function *f = g->instance->scene->functions + e->what;
    const int32_t *words = g->tape->words + e->words;
    const Flat *flat = gradient_flat(g, e->what);
    const int constants = g->instance->scene->constant_count;
    Lanes *d = g->lane_registers + constants;
    size_t k = 0;
    if (!flat)
        return;
    for (int j = 0; j < f->inputs; d += f->lengths[j++])
        if (words[j] < 0)
            memset(d, 0, (size_t)f->lengths[j] * sizeof *d);
        else
            memcpy(d, t + words[j], (size_t)f->lengths[j] * sizeof *d);
    tangents_through(flat, g->instance->registers, g->lane_registers);
    for (int j = f->inputs; j < f->inputs + f->outputs; j++)
        for (int each = 0; each < f->lengths[j]; each++, k++)
            if (words[j] >= 0)
                t[words[j] + each] = g->lane_registers[function_result_place(f, k)];
}

/* Propagate tangents to the factors of a matrix that is a weighted sum of parts. */
static void tangent_of_factor(const Tape *tape, const Entry *e, Lanes *t)
{
    const int32_t *words = tape->words + e->words;
    const int n = words[0], s = words[1], terms = words[2], size = n * s;
    const double *weights = tape->numbers + e->numbers, *parts = weights + s * s * terms;
    Lanes *a = t + words[4 + s * terms];
    memset(a, 0, (size_t)(size * size) * sizeof *a);
    for (int term = 0; term < terms; term++)
        for (int i = 0; i < s; i++)
            for (int j = 0; j < s; j++) {
                const int which = (term * s + i) * s + j;
                const double weight = weights[which], *part = parts + (term * s + i) * n * n;
                const Lanes *own = words[3] < 0 ? NULL : t + words[3] + which;
                const Lanes *inner = words[4 + term * s + i] < 0 ? NULL : t + words[4 + term * s + i];
                for (int r = 0; r < n; r++)
                    for (int c = 0; c < n; c++) {
                        Lanes *to = a + (i * n + r) * size + j * n + c;
                        if (inner)
                            tangent_along(to, weight, inner + c * n + r);
                        if (own)
                            tangent_along(to, part[c * n + r], own);
                    }
            }
}

static const double *factors_of(const Tape *tape, const int32_t *words)
{
    const int blocks = words[1];
    return tape->numbers + ((size_t)words[5 + blocks] << 31 | (size_t)words[4 + blocks]);
}

/* A dx = db - dA x */
static void tangent_of_solve(Gradient *g, const Entry *e, Lanes *t)
{
    const Tape *tape = g->tape;
    const int32_t *words = tape->words + e->words;
    const int n = words[0], s = words[1], size = n * s;
    const double *x = tape->numbers + e->numbers, *factors = factors_of(tape, words);
    const Lanes *a = t + words[2];
    const size_t used = g->instance->used;
    double *right = arena_alloc(g->instance, (size_t)size), *change = arena_alloc(g->instance, (size_t)size);
    Lanes *to = words[3 + s] < 0 ? NULL : t + words[3 + s];
    for (int lane = 0; to && lane < LANES; lane++) {
        const double *rows[MOST_ARGUMENTS];
        for (int i = 0; i < size; i++) {
            const int32_t from = words[3 + i / n];
            double sum = from < 0 ? 0.0 : t[from + i % n].lane[lane];
            for (int j = 0; j < size; j++)
                sum -= a[i * size + j].lane[lane] * x[j];
            right[i] = sum;
        }
        for (int i = 0; i < s; i++)
            rows[i] = right + i * n;
        linear_solve(n, s, factors, factors + size * size, rows, change);
        for (int i = 0; i < size; i++)
            to[i].lane[lane] = change[i];
    }
    g->instance->used = used;
}

/* Solve x = A+ b, with the pseudoinverse that tangents use. */
static void least(Instance *i, int side, const double *a, const double *b, double *x)
{
    linear_least_norm(side, side, a, b, DBL_EPSILON * side, x, i->dense);
}

static void transposed(int side, const double *a, double *into)
{
    for (int r = 0; r < side; r++)
        for (int c = 0; c < side; c++)
            into[r * side + c] = a[c * side + r];
}

static void product_of(int side, const double *a, const double *x, double *y)
{
    for (int r = 0; r < side; r++) {
        y[r] = 0.0;
        for (int c = 0; c < side; c++)
            y[r] += a[c * side + r] * x[c];
    }
}

/* Differentiate x = A+ b at constant rank: dx = A+ (db - dA x) + A+ A+' dA' (b - A x) + (1 - A+ A) dA' A+' x. */
static void tangent_of_least_norm(Gradient *g, const Entry *e, Lanes *t)
{
    Instance *i = g->instance;
    const int32_t *words = g->tape->words + e->words;
    const int side = words[0];
    const size_t n = (size_t)side, arena = arena_mark(i);
    const double *a = g->tape->numbers + e->numbers, *b = a + n * n, *x = b + n;
    double *back = arena_alloc(i, n * n), *left = arena_alloc(i, n), *lam = arena_alloc(i, n), *rhs = arena_alloc(i, n),
           *row = arena_alloc(i, n);
    double *u = arena_alloc(i, n), *w = arena_alloc(i, n);
    Lanes *to = words[3] < 0 ? NULL : t + words[3];
    int sure;
    transposed(side, a, back);
    product_of(side, a, x, left);
    for (int k = 0; k < side; k++)
        left[k] = b[k] - left[k];
    least(i, side, back, x, lam); /* A+' x */
    sure = linear_rank_is_sure(side, DBL_EPSILON * side, i->dense);
    for (int lane = 0; to && lane < LANES; lane++) {
        for (int r = 0; r < side; r++) {
            rhs[r] = words[2] < 0 ? 0.0 : t[words[2] + r].lane[lane];
            row[r] = u[r] = 0.0;
        }
        for (int c = 0; words[1] >= 0 && c < side; c++)
            for (int r = 0; r < side; r++) {
                const double da = t[words[1] + c * side + r].lane[lane];
                rhs[r] -= da * x[c];
                row[c] += da * lam[r]; /* dA' A+' x */
                u[c] += da * left[r];  /* dA' (b - A x) */
            }
        least(i, side, back, u, w); /* A+' dA' (b - A x) */
        product_of(side, a, row, u);
        for (int r = 0; r < side; r++)
            rhs[r] += w[r] - u[r];
        least(i, side, a, rhs, w);
        for (int r = 0; r < side; r++)
            to[r].lane[lane] = sure || w[r] + row[r] == 0.0 ? w[r] + row[r] : NAN;
    }
    arena_release(i, arena);
}

static void tangent_of_copy(const int32_t *words, Lanes *t)
{
    if (words[0] >= 0 && words[1] >= 0)
        memmove(t + words[0], t + words[1], (size_t)words[2] * sizeof *t);
    else if (words[0] >= 0)
        memset(t + words[0], 0, (size_t)words[2] * sizeof *t);
}

static void tangent_of_sum(const Tape *tape, const Entry *e, Lanes *t)
{
    const int32_t *words = tape->words + e->words;
    Lanes sum;
    memset(&sum, 0, sizeof sum);
    for (int k = 0; k < e->what; k++)
        if (words[1 + k] >= 0)
            tangent_along(&sum, tape->numbers[e->numbers + (size_t)k], t + words[1 + k]);
    if (words[0] >= 0)
        t[words[0]] = sum;
}

/* Propagate all tangents of the instance along its tape. */
void tangents_along(Gradient *g, Mark from)
{
    const Tape *tape = g->tape;
    for (size_t k = from.entries; k < tape->used.entries && !g->lost; k++) {
        const Entry *e = tape->entries + k;
        const int32_t *words = tape->words + e->words;
        if (e->kind == CALLED)
            gradient_values_again(g, e->what, tape->numbers + e->numbers);
        else if (e->kind == CLOSED)
            closed_tangents(g, e);
        else if (e->kind == RATED)
            rated_tangents(g, e);
        else if (e->kind == AIMED)
            aimed_tangents(g, e);
        else if (e->kind == HELD)
            held_tangents(g, e);
        for (int block = 0; block < g->blocks; block++) {
            Lanes *t = g->tangents + (size_t)block * g->places;
            switch (e->kind) {
            case CALLED:
                tangent_of_call(g, e, t);
                break;
            case COPIED:
                tangent_of_copy(words, t);
                break;
            case CLEARED:
                if (words[0] >= 0)
                    memset(t + words[0], 0, (size_t)words[1] * sizeof *t);
                break;
            case COMBINED:
                tangent_of_sum(tape, e, t);
                break;
            case FACTORED:
                tangent_of_factor(tape, e, t);
                break;
            case SOLVED:
                tangent_of_solve(g, e, t);
                break;
            case LEAST_NORMED:
                tangent_of_least_norm(g, e, t);
                break;
            }
        }
    }
}
