#include "least_squares.h"

#include "instance.h"
#include "layout.h"
#include "linear.h"
#include "scene.h"

Matrix matrix_new(Instance *i, const Pattern *pattern)
{
    return (Matrix){pattern, arena_alloc(i, (size_t)pattern->entries)};
}

/* Compute y = A x. */
void matrix_times(Matrix a, const double *x, double *y)
{
    const Pattern *p = a.pattern;
    memset(y, 0, (size_t)p->rows * sizeof *y);
    for (int c = 0; c < p->columns; c++)
        for (int e = p->offsets[c]; e < p->offsets[c + 1]; e++)
            y[p->indices[e]] += a.values[e] * x[c];
}

/* Multiply each row and each column by its weight; `columns` may be NULL. */
void matrix_weigh(Matrix a, const double *rows, const double *columns)
{
    for (int c = 0; c < a.pattern->columns; c++)
        for (int e = a.pattern->offsets[c]; e < a.pattern->offsets[c + 1]; e++)
            a.values[e] *= rows[a.pattern->indices[e]] * (columns ? columns[c] : 1.0);
}

void rows_times(const Rows *J, const double *x, double *y)
{
    matrix_times(J->constraints, x, y);
    matrix_times(J->ties, x, y + J->constraints.pattern->rows);
}

void rows_times_back(const Rows *J, const double *y, double *x)
{
    const Matrix parts[] = {J->constraints, J->ties};
    memset(x, 0, (size_t)parts->pattern->columns * sizeof *x);
    for (int k = 0; k < 2; y += parts[k++].pattern->rows)
        for (int c = 0; c < parts[k].pattern->columns; c++) {
            double sum = x[c];
            for (int e = parts[k].pattern->offsets[c]; e < parts[k].pattern->offsets[c + 1]; e++)
                sum += parts[k].values[e] * y[parts[k].pattern->indices[e]];
            x[c] = sum;
        }
}

/* Compute J J', regularised by LOOSE of its largest entry on the diagonal; return that entry. */
double rows_squared(Instance *i, const Rows *J, double *a)
{
    const Envelope *e = &i->scene->closing;
    const Pattern *above = J->constraints.pattern, *below = J->ties.pattern;
    const size_t arena = arena_mark(i);
    double *values = arena_alloc(i, (size_t)e->size), *places = arena_alloc(i, (size_t)e->size), most = 0.0;
    memset(a, 0, e->entries * sizeof *a);
    for (int c = 0; c < above->columns; c++) {
        int count = 0;
        for (int k = above->offsets[c]; k < above->offsets[c + 1]; k++, count++) {
            values[count] = J->constraints.values[k];
            places[count] = e->place[above->indices[k]];
        }
        for (int k = below->offsets[c]; k < below->offsets[c + 1]; k++, count++) {
            values[count] = J->ties.values[k];
            places[count] = e->place[above->rows + below->indices[k]];
        }
        for (int k = 0; k < count; k++)
            for (int j = 0; j <= k; j++) {
                const int row = (int)(places[k] > places[j] ? places[k] : places[j]);
                const int column = (int)(places[k] + places[j]) - row;
                a[e->start[row] + column] += values[k] * values[j];
            }
    }
    for (int r = 0; r < e->size; r++)
        most = fmax(most, *envelope_entry(e, a, r, r));
    most = most > 0.0 ? most : 1.0;
    for (int r = 0; r < e->size; r++)
        *envelope_entry(e, a, r, r) += LOOSE * most;
    arena_release(i, arena);
    return most;
}

/* Find x (n) of least norm that minimises |J x - r|: the correction (10) with the unit matrix for M, repeated while it
   gains, at most `most` times. x = J' lam, where each pass adds (J J' + 1 / alpha)^-1 (r - J x) to lam, so that
   dependent rows share it. Directions that rows hold less than about 1e-6 of others do not converge within these
   passes. */
void rows_least_multipliers(Instance *i, const Rows *J, const double *r, int most, double *lam, double *x)
{
    const Envelope *e = &i->scene->closing;
    const size_t arena = arena_mark(i), rows = (size_t)e->size;
    double *a = arena_alloc(i, e->entries), *left = arena_alloc(i, rows), *change = arena_alloc(i, rows);
    double *work = arena_alloc(i, rows), size = linear_norm(r, e->size), before = INFINITY;
    rows_squared(i, J, a);
    envelope_factor(e, a, DBL_MIN);
    memset(lam, 0, rows * sizeof *lam);
    memset(x, 0, (size_t)i->scene->n * sizeof *x);
    memcpy(left, r, rows * sizeof *left);
    for (int pass = 0; pass < most && size > 0.0 && size < GAINED * before; pass++) {
        envelope_solve(e, a, left, change, work);
        for (int k = 0; k < e->size; k++)
            lam[k] += change[k];
        rows_times_back(J, lam, x);
        rows_times(J, x, left);
        for (int k = 0; k < e->size; k++)
            left[k] = r[k] - left[k];
        before = size;
        size = linear_norm(left, e->size);
    }
    arena_release(i, arena);
}

void rows_least_correction(Instance *i, const Rows *J, const double *r, int most, double *x)
{
    const size_t arena = arena_mark(i);
    rows_least_multipliers(i, J, r, most, arena_alloc(i, (size_t)i->scene->closing.size), x);
    arena_release(i, arena);
}
