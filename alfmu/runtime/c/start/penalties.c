#include "penalties.h"

#include "equations.h"
#include "instance.h"
#include "layout.h"
#include "row_units.h"
#include "scene.h"

/* Return whether two rows are directions of one joint, which are orthogonal. */
static int are_of_one_joint(const Scene *s, int a, int b)
{
    return a == b || (s->rows[a].size > 0.0 && s->rows[b].size > 0.0 && !strcmp(s->rows[a].name, s->rows[b].name));
}

/* Count how often each constraint is written. Rows that are multiples of each other at all positions have the same
   ratio of two sums: their coefficients times random numbers, and the norm of the coefficients. The rows of one joint
   count as parts of one constraint, split along the joint's axes. */
static void count_copies(Instance *i, const double *q, double *count)
{
    const Scene *s = i->scene;
    const Pattern *p = &s->constraint;
    const size_t arena = arena_mark(i), n = (size_t)s->n, l = (size_t)s->l;
    double *C = arena_alloc(i, (size_t)p->entries), *there = arena_alloc(i, n), *zeros = arena_alloc(i, n);
    double *sums = arena_alloc(i, l), *squares = arena_alloc(i, l), *parts = arena_alloc(i, l);
    memset(zeros, 0, n * sizeof *zeros);
    memset(sums, 0, l * sizeof *sums);
    memset(squares, 0, l * sizeof *squares);
    for (int k = 0; k < SIDE_PLACES; k++) {
        for (int c = 0; c < s->n; c++)
            there[c] = q[c] + side_places[k] * s->normal[c] * (coordinate_is_length(s, c) ? LITTLE : 1.0);
        constraints_evaluate(i, there, zeros, NULL, C, NULL, NULL);
        for (int c = 0; c < s->n; c++)
            for (int e = p->offsets[c]; e < p->offsets[c + 1]; e++) {
                sums[p->indices[e]] += C[e] * s->normal[(k + 1) * s->n + c];
                squares[p->indices[e]] += C[e] * C[e];
            }
    }
    for (int r = 0; r < s->l; r++) {
        sums[r] = fabs(sums[r]) / sqrt(fmax(squares[r], 1e-300));
        parts[r] = s->rows[r].size > 0.0 ? squares[r] / (s->rows[r].size * s->rows[r].size) : 1.0;
    }
    for (int r = 0; r < s->l; r++) {
        double all = 0.0, own = 0.0;
        for (int other = 0; other < s->l; other++)
            if (fabs(sums[r] - sums[other]) <= SAME * sums[r]) {
                all += parts[other];
                own += are_of_one_joint(s, r, other) ? parts[other] : 0.0;
            }
        count[r] = all > own && own > 0.0 ? all / own : 1.0; /* NaN equals no other row. */
    }
    arena_release(i, arena);
}

void penalties_default(Instance *i, const double *q, double *penalties)
{
    const Scene *s = i->scene;
    const Pattern *m = &s->mass, *p = &s->constraint;
    const size_t arena = arena_mark(i), l = (size_t)s->l, entries = (size_t)p->entries;
    double *M = arena_alloc(i, (size_t)m->entries), *held = arena_alloc(i, (size_t)s->n), *written = arena_alloc(i, l);
    double *units = i->units, mean = 0.0, heaviest = 0.0, wide = 0.0;
    Range *sizes = (Range *)arena_alloc(i, 3 * entries), *amplitudes = (Range *)arena_alloc(i, 3 * entries);
    Range all = {0.0, INFINITY, 0.0};
    Row_units *told = (Row_units *)arena_alloc(i, 8 * l);
    int known = 1, every_angular = 1, every_exact = 1;
    units_sample_coefficients(i, q, M, sizes, amplitudes);
    for (int c = 0; c < s->n; c++)
        for (int e = p->offsets[c]; coordinate_is_length(s, c) && e < p->offsets[c + 1]; e++) {
            Range *each[] = {sizes + e, amplitudes + e};
            for (int k = 0; k < 2; k++)
                *each[k] = (Range){
                    each[k]->first * *i->length, each[k]->least * *i->length, each[k]->most * *i->length};
        }
    memset(told, 0, l * sizeof *told);
    units_tell(s, sizes, amplitudes, told);
    for (int r = 0; r < s->l; r++) {
        const int declared = s->rows[r].size > 0.0;
        units[r]
            = declared ? s->rows[r].size * (strcmp(s->rows[r].unit, "m") ? 1.0 : *i->length) : units_of_row(told + r);
        known &= declared || units_constant(told + r) > 0.0 || units_are_telling(told + r, told[r].lengths)
            || told[r].angular > 0.0;
        every_angular &= told[r].angular > 0.0 && !declared;
        every_exact &= units_constant(told + r) > 0.0;
    }
    for (int r = 0; r < s->l; r++) {
        if (every_angular && !every_exact)
            units[r] = told[r].angular;
        if (units[r] == 0.0)
            units[r] = 1.0;
        range_widen(&all, units[r]);
    }
    for (int r = 0; r < s->l; r++) {
        if (range_is_constant(all))
            units[r] = all.most;
        mean += log(units[r]) / s->l;
    }
    mean = exp(mean);
    for (int r = 0; !known && all.most <= ALIKE * all.least && r < s->l; r++)
        units[r] = 1 / ALIKE < mean && mean < ALIKE ? 1.0 : mean;
    for (int c = 0; c < s->n; c++) {
        double own = 0.0; /* norm over the rows of a joint, whose axes may have any direction */
        held[c] = 0.0;
        for (int e = p->offsets[c]; e < p->offsets[c + 1]; e++) {
            const int r = p->indices[e], more = e > p->offsets[c] && are_of_one_joint(s, p->indices[e - 1], r);
            own = more ? hypot(own, sizes[e].most / units[r]) : sizes[e].most / units[r];
            held[c] = fmax(held[c], own);
        }
        wide = fmax(wide, held[c]);
    }
    for (int c = 0; c < s->n; c++)
        for (int e = m->offsets[c]; held[c] > HARDLY * wide && e < m->offsets[c + 1]; e++)
            if (m->indices[e] == c) {
                const double size = coordinate_is_length(s, c) ? 1 / *i->length : held[c];
                heaviest = fmax(heaviest, M[e] / (size * size));
            }
    heaviest = heaviest > 0.0 ? heaviest : 1 / PENALTY_RATIO; /* Statics without mass holds by any penalty. */
    /* Divide the penalty of a constraint by the number of its copies, so that together they hold as one. */
    count_copies(i, q, written);
    for (int r = 0; r < s->l; r++) {
        units[r] *= sqrt(written[r]);
        penalties[r] = PENALTY_RATIO * heaviest / (units[r] * units[r]);
    }
    arena_release(i, arena);
}
