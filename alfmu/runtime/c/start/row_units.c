#include "row_units.h"

#include "equations.h"
#include "instance.h"
#include "layout.h"
#include "scene.h"

void range_widen(Range *range, double x)
{
    if (range->least > range->most)
        range->first = x;
    range->least = fmin(range->least, x);
    range->most = fmax(range->most, x);
}

int range_is_constant(Range range)
{
    return range.most - range.least <= SAME * range.most;
}

/* Sample the nonzeros of C at several positions, and amplitudes of those that belong to angles, from a second
   evaluation a quarter turn further. Nonzeros that are round-off at all positions are set to zero: otherwise a
   constraint of such nonzeros only would get its own penalty and hold a motion. */
void units_sample_coefficients(Instance *i, const double *q, double *M, Range *sizes, Range *amplitudes)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n, entries = (size_t)s->constraint.entries;
    const int *offsets = s->constraint.offsets;
    double *C = arena_alloc(i, entries), *turned = arena_alloc(i, entries), *own = arena_alloc(i, entries);
    double *there = arena_alloc(i, n), *zeros = arena_alloc(i, n), most = 1.0;
    memset(zeros, 0, n * sizeof *zeros);
    for (size_t e = 0; e < entries; e++)
        sizes[e] = amplitudes[e] = (Range){0.0, INFINITY, 0.0};
    for (int k = 0; k < SIDE_PLACES; k++) {
        for (int c = 0; c < s->n; c++)
            there[c] = q[c] + side_places[k] * s->normal[c] * (coordinate_is_length(s, c) ? LITTLE : 1.0);
        constraints_evaluate(i, there, zeros, k ? NULL : M, C, NULL, NULL);
        memset(own, 0, entries * sizeof *own);
        for (int c = 0; c < s->n && s->n <= DENSE; c++) {
            const double kept = there[c];
            if (!coordinate_is_angle(s, c))
                continue;
            there[c] += QUARTER;
            constraints_evaluate(i, there, zeros, NULL, turned, NULL, NULL);
            memcpy(own + offsets[c], turned + offsets[c], (size_t)(offsets[c + 1] - offsets[c]) * sizeof *own);
            there[c] = kept;
        }
        for (size_t e = 0; e < entries; e++) {
            range_widen(sizes + e, fabs(C[e]));
            range_widen(amplitudes + e, hypot(C[e], own[e]));
            most = fmax(most, fabs(C[e]));
        }
    }
    for (size_t e = 0; e < entries; e++)
        if (amplitudes[e].most <= SAME * most)
            sizes[e] = amplitudes[e] = (Range){0.0, 0.0, 0.0};
    arena_release(i, arena);
}

static double units_sum(Sum sum)
{
    return sqrt(sum.squares / fmax(sum.count, 1.0));
}

void units_tell(const Scene *s, const Range *sizes, const Range *amplitudes, Row_units *told)
{
    const Pattern *p = &s->constraint;
    for (int c = 0; c < s->n; c++)
        for (int e = p->offsets[c]; e < p->offsets[c + 1]; e++) {
            Row_units *row = told + p->indices[e];
            Sum *sum = coordinate_is_length(s, c) ? &row->lengths : coordinate_is_angle(s, c) ? NULL : &row->euler;
            if (sum) {
                sum->squares += sizes[e].first * sizes[e].first;
                sum->count += sizes[e].most > 0.0;
            }
            row->most = fmax(row->most, sizes[e].most);
            if (coordinate_is_angle(s, c) && range_is_constant(amplitudes[e]))
                row->angular = fmax(row->angular, amplitudes[e].first);
            if (range_is_constant(sizes[e]))
                row->constant = fmax(row->constant, sizes[e].most);
            if (range_is_constant(sizes[e]) && coordinate_is_length(s, c))
                row->constant_length = fmax(row->constant_length, sizes[e].most);
        }
}

/* Return the length of the mechanism: the longest arm at which an angle moves a point; for constraints on lengths alone
   the least radius at which their coefficients turn; 1 m if neither exists. Arms of rows in scaled units are divided by
   the row's known unit; arms without a known unit count only if no unit is known. `loop` becomes the size of the
   smallest loop: the least of the longest arms of rows, or that radius. */
double units_own_length(Instance *i, const double *q, double *loop)
{
    const Scene *s = i->scene;
    const Pattern *p = &s->constraint;
    const size_t arena = arena_mark(i), n = (size_t)s->n, l = (size_t)s->l, entries = (size_t)p->entries;
    double *C = arena_alloc(i, entries), *turned = arena_alloc(i, entries), *there = arena_alloc(i, n),
           *zeros = arena_alloc(i, n);
    double *size = arena_alloc(i, l), *moved = arena_alloc(i, l), *bent = arena_alloc(i, l),
           *reached = arena_alloc(i, l), known = 0.0, arm = 0.0, radius = INFINITY, least = INFINITY,
           found;
    Range *sizes = (Range *)arena_alloc(i, 3 * entries), *amplitudes = (Range *)arena_alloc(i, 3 * entries);
    Row_units *told = (Row_units *)arena_alloc(i, 8 * l);
    memset(zeros, 0, n * sizeof *zeros);
    memset(told, 0, l * sizeof *told);
    memset(reached, 0, l * sizeof *reached);
    constraints_evaluate(i, q, zeros, NULL, C, NULL, NULL);
    units_sample_coefficients(i, q, NULL, sizes, amplitudes);
    units_tell(s, sizes, amplitudes, told);
    for (int c = 0; c < s->n; c++)
        for (int e = p->offsets[c]; !coordinate_is_length(s, c) && e < p->offsets[c + 1]; e++) {
            const int r = p->indices[e];
            /* The Euler parameters of a body together change by half its angle, whatever its attitude. */
            reached[r] = coordinate_is_angle(s, c) ? fmax(reached[r], amplitudes[e].most)
                                                   : hypot(reached[r], 0.5 * C[e]);
        }
    for (int r = 0; r < s->l; r++)
        if (!strcmp(s->rows[r].unit, "m")) {
            const double unit = s->rows[r].size > 0.0 ? s->rows[r].size : told[r].constant_length;
            size[r] = unit > 0.0 ? reached[r] / unit : 0.0;
            known = fmax(known, size[r]);
            arm = fmax(arm, reached[r]);
        }
    for (int r = 0; r < s->l; r++)
        if (!strcmp(s->rows[r].unit, "m")) {
            const double own = known > 0.0 ? size[r] : reached[r];
            least = own > SAME * (known > 0.0 ? known : arm) ? fmin(least, own) : least;
        }
    for (int k = 0; k < RANKED && arm == 0.0; k++) { /* A displacement along the radius turns nothing: try several. */
        memset(size, 0, l * sizeof *size);
        memset(moved, 0, l * sizeof *moved);
        memset(bent, 0, l * sizeof *bent);
        for (int c = 0; c < s->n; c++)
            there[c] = q[c] + LITTLE * s->normal[k * s->n + c] * coordinate_is_length(s, c);
        constraints_evaluate(i, there, zeros, NULL, turned, NULL, NULL);
        for (int c = 0; c < s->n; c++)
            for (int e = p->offsets[c]; coordinate_is_length(s, c) && e < p->offsets[c + 1]; e++) {
                const int r = p->indices[e];
                size[r] = hypot(size[r], C[e]);
                moved[r] = hypot(moved[r], there[c] - q[c]);
                bent[r] = hypot(bent[r], turned[e] - C[e]);
            }
        for (int r = 0; r < s->l; r++)
            if (!strcmp(s->rows[r].unit, "m") && bent[r] > SAME * size[r])
                radius = fmin(radius, moved[r] * size[r] / bent[r]);
    }
    found = known > 0.0 ? known : arm > 0.0 ? arm : radius;
    found = found >= 1e-300 && found < 1e12 ? found : 1.0;
    *loop = fmin(fmin(least, radius), found);
    arena_release(i, arena);
    return found;
}

/* Return the constant coefficient of a row, that of a length if it has lengths. */
double units_constant(const Row_units *row)
{
    return row->lengths.count > 0.0 ? row->constant_length : row->constant;
}

/* Return whether these coefficients determine the unit of their row. In closed loops, coefficients of a slide across
   the row, or of the attitude of a body that carries the whole loop, are round-off. */
int units_are_telling(const Row_units *row, Sum sum)
{
    return units_sum(sum) > HARDLY * row->most;
}

/* Return the value of a row per unit of displacement: 1 in metres and radians, 1000 in millimetres, 0 without
   coefficients. It is the row's constant coefficient, or else follows from the norm of its length or Euler
   coefficients, or is the constant amplitude of an angle; otherwise it is estimated by the largest coefficient. */
double units_of_row(const Row_units *row)
{
    return units_constant(row) > 0.0         ? units_constant(row)
        : units_are_telling(row, row->lengths)   ? sqrt(2.0) * units_sum(row->lengths)
        : units_are_telling(row, row->euler)     ? units_sum(row->euler)
        : row->angular > 0.0           ? row->angular
                                       : row->most;
}
