/* Propagates adjoints back along a tape, from one number at the end to all numbers at the beginning, at a cost that
   does not depend on their number. The rules are those of tangent.c, transposed. */

#include "adjoint.h"

#include "function_adjoints.h"
#include "gradient.h"
#include "input_derivatives.h"
#include "instance.h"
#include "linear.h"
#include "record.h"
#include "scene.h"
#include "start_derivatives.h"

static void adjoint_of_call(Gradient *g, const Entry *e)
{
    const Function *f = g->instance->scene->functions + e->what;
    const int32_t *words = g->tape->words + e->words;
    const int constants = g->instance->scene->constant_count;
    double *ar = g->registers, *a = g->adjoints, *d = ar + constants;
    const double *values;
    const Flat *flat;
    int any = 0;
    size_t k = 0;
    for (int j = f->inputs; j < f->inputs + f->outputs && !any; j++)
        for (int each = 0; words[j] >= 0 && each < f->lengths[j]; each++)
            any |= a[words[j] + each] != 0.0;
    if (!any || !(flat = gradient_flat(g, e->what)))
        return;
    values = gradient_values_again(g, e->what, g->tape->numbers + e->numbers);
    memset(d, 0, (size_t)(flat->registers - constants) * sizeof *d);
    for (int j = f->inputs; j < f->inputs + f->outputs; j++)
        for (int each = 0; each < f->lengths[j]; each++, k++)
            if (words[j] >= 0) {
                ar[function_result_place(f, k)] += a[words[j] + each];
                a[words[j] + each] = 0.0;
            }
    adjoints_through(flat, values, ar);
    for (int j = 0; j < f->inputs; d += f->lengths[j++])
        for (int each = 0; words[j] >= 0 && each < f->lengths[j]; each++)
            a[words[j] + each] += d[each];
}

static void adjoint_of_factor(const Tape *tape, const Entry *e, double *adjoints)
{
    const int32_t *words = tape->words + e->words;
    const int n = words[0], s = words[1], terms = words[2], size = n * s;
    const double *weights = tape->numbers + e->numbers, *parts = weights + s * s * terms;
    double *a = adjoints + words[4 + s * terms];
    for (int term = 0; term < terms; term++)
        for (int i = 0; i < s; i++)
            for (int j = 0; j < s; j++) {
                const int which = (term * s + i) * s + j;
                const double weight = weights[which], *part = parts + (term * s + i) * n * n;
                double *own = words[3] < 0 ? NULL : adjoints + words[3] + which;
                double *inner = words[4 + term * s + i] < 0 ? NULL : adjoints + words[4 + term * s + i];
                for (int r = 0; r < n; r++)
                    for (int c = 0; c < n; c++) {
                        const double w = a[(i * n + r) * size + j * n + c];
                        if (inner && w != 0.0)
                            inner[c * n + r] += weight * w;
                        if (own && w != 0.0)
                            *own += part[c * n + r] * w;
                    }
            }
    memset(a, 0, (size_t)(size * size) * sizeof *a);
}

/* Solve A' w = x with the factors of A: rows of A in `order`, L with unit diagonal below U. */
static void solve_back(int size, const double *a, const double *order, double *x, double *w)
{
    for (int i = 0; i < size; i++) {
        for (int j = 0; j < i; j++)
            x[i] -= a[j * size + i] * x[j];
        x[i] /= a[i * size + i];
    }
    for (int i = size - 1; i >= 0; i--)
        for (int j = i + 1; j < size; j++)
            x[i] -= a[j * size + i] * x[j];
    for (int i = 0; i < size; i++)
        w[(int)order[i]] = x[i];
}

static void adjoint_of_solve(Gradient *g, const Entry *e)
{
    const Tape *tape = g->tape;
    const int32_t *words = tape->words + e->words;
    const int n = words[0], s = words[1], size = n * s, to = words[3 + s];
    const double *x = tape->numbers + e->numbers;
    const double *factors = tape->numbers + ((size_t)words[5 + s] << 31 | (size_t)words[4 + s]);
    const size_t used = g->instance->used;
    double *ax = arena_alloc(g->instance, (size_t)size), *w = arena_alloc(g->instance, (size_t)size), *a = g->adjoints;
    int any = 0;
    for (int i = 0; to >= 0 && i < size; i++) {
        ax[i] = a[to + i];
        any |= ax[i] != 0.0;
        a[to + i] = 0.0;
    }
    if (any) {
        solve_back(size, factors, factors + size * size, ax, w);
        for (int i = 0; i < size; i++) {
            const int32_t from = words[3 + i / n];
            if (from >= 0)
                a[from + i % n] += w[i];
            for (int j = 0; j < size; j++)
                a[words[2] + i * size + j] -= w[i] * x[j];
        }
    }
    g->instance->used = used;
}

static void adjoint_of_least_norm(Gradient *g, const Entry *e)
{
    Instance *i = g->instance;
    const int32_t *words = g->tape->words + e->words;
    const int side = words[0];
    const double few = DBL_EPSILON * side;
    const size_t n = (size_t)side, arena = arena_mark(i);
    const double *a = g->tape->numbers + e->numbers, *b = a + n * n, *x = b + n;
    double *back = arena_alloc(i, n * n), *left = arena_alloc(i, n), *lam = arena_alloc(i, n), *w = arena_alloc(i, n),
           *z = arena_alloc(i, n);
    double *ww = arena_alloc(i, n), *ax = arena_alloc(i, n);
    int any = 0;
    for (int k = 0; words[3] >= 0 && k < side; k++) {
        ax[k] = g->adjoints[words[3] + k];
        any |= ax[k] != 0.0;
        g->adjoints[words[3] + k] = 0.0;
    }
    if (any) {
        for (int r = 0; r < side; r++)
            for (int c = 0; c < side; c++)
                back[r * side + c] = a[c * side + r];
        for (int r = 0; r < side; r++) {
            left[r] = b[r];
            for (int c = 0; c < side; c++)
                left[r] -= a[c * side + r] * x[c];
        }
        linear_least_norm(side, side, back, x, few, lam, i->dense);
        linear_least_norm(side, side, back, ax, few, w, i->dense); /* A+' ax */
        linear_least_norm(side, side, a, w, few, ww, i->dense);    /* A+ A+' ax */
        if (!linear_rank_is_sure(side, few, i->dense))
            w[0] = NAN;
        for (int c = 0; c < side; c++) {                    /* (1 - A+ A) ax */
            z[c] = ax[c];
            for (int r = 0; r < side; r++)
                z[c] -= a[c * side + r] * w[r];
        }
        for (int r = 0; r < side; r++)
            if (words[2] >= 0)
                g->adjoints[words[2] + r] += w[r];
        for (int c = 0; words[1] >= 0 && c < side; c++)
            for (int r = 0; r < side; r++)
                g->adjoints[words[1] + c * side + r] += left[r] * ww[c] + lam[r] * z[c] - w[r] * x[c];
    }
    arena_release(i, arena);
}

static void adjoint_of_copy(const int32_t *words, double *a)
{
    for (int32_t k = 0; words[0] >= 0 && k < words[2]; k++) {
        const double w = a[words[0] + k];
        a[words[0] + k] = 0.0;
        if (words[1] >= 0)
            a[words[1] + k] += w;
    }
}

static void adjoint_of_sum(const Tape *tape, const Entry *e, double *a)
{
    const int32_t *words = tape->words + e->words;
    const double w = words[0] < 0 ? 0.0 : a[words[0]];
    if (words[0] >= 0)
        a[words[0]] = 0.0;
    for (int k = 0; k < e->what; k++)
        if (words[1 + k] >= 0)
            a[words[1 + k]] += tape->numbers[e->numbers + (size_t)k] * w;
}

/* Propagate all adjoints of the instance back along its tape, down to a mark. */
void adjoints_along(Gradient *g, Mark from)
{
    const Tape *tape = g->tape;
    for (size_t k = tape->used.entries; k-- > from.entries && !g->lost;) {
        const Entry *e = tape->entries + k;
        const int32_t *words = tape->words + e->words;
        switch (e->kind) {
        case CALLED:
            adjoint_of_call(g, e);
            break;
        case COPIED:
            adjoint_of_copy(words, g->adjoints);
            break;
        case CLEARED:
            if (words[0] >= 0)
                memset(g->adjoints + words[0], 0, (size_t)words[1] * sizeof *g->adjoints);
            break;
        case COMBINED:
            adjoint_of_sum(tape, e, g->adjoints);
            break;
        case FACTORED:
            adjoint_of_factor(tape, e, g->adjoints);
            break;
        case SOLVED:
            adjoint_of_solve(g, e);
            break;
        case LEAST_NORMED:
            adjoint_of_least_norm(g, e);
            break;
        case CLOSED:
            closed_adjoints(g, e);
            break;
        case RATED:
            rated_adjoints(g, e);
            break;
        case AIMED:
            aimed_adjoints(g, e);
            break;
        case HELD:
            held_adjoints(g, e);
            break;
        }
    }
}
