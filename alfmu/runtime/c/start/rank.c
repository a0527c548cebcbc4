#include "rank.h"

#include "equations.h"
#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "least_squares.h"
#include "linear.h"
#include "message.h"
#include "record.h"
#include "row_units.h"
#include "scene.h"
#include "scene_sizes.h"

/* Evaluate Phi and C at q, each row times its weight. */
void rank_weighted_rows(Instance *i, const double *q, const double *weights, Matrix C, double *phi)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *zeros = arena_alloc(i, (size_t)s->n);
    memset(zeros, 0, (size_t)s->n * sizeof *zeros);
    constraints_evaluate(i, q, zeros, NULL, C.values, phi, NULL);
    matrix_weigh(C, weights, NULL);
    for (int r = 0; r < s->l; r++)
        phi[r] *= weights[r];
    arena_release(i, arena);
}

/* Return the rank of C: its number of singular values above round-off. */
static int count_rank(Instance *i, Matrix C)
{
    const Scene *s = i->scene;
    const int wide = s->l < s->n, few = wide ? s->l : s->n, many = wide ? s->n : s->l;
    const size_t arena = arena_mark(i);
    double *a = arena_alloc(i, (size_t)many * (size_t)few), *sizes = arena_alloc(i, (size_t)few);
    const double least = 1e-7 * fmax(1.0, linear_largest(C.values, C.pattern->entries));
    int rank = 0;
    if (wide) {
        memset(a, 0, (size_t)many * (size_t)few * sizeof *a);
        for (int c = 0; c < s->n; c++)
            for (int e = C.pattern->offsets[c]; e < C.pattern->offsets[c + 1]; e++)
                a[C.pattern->indices[e] * s->n + c] = C.values[e];
    } else
        pattern_spread(C.pattern, C.values, a, s->l);
    linear_singular_values(many, few, a, NULL, sizes);
    while (rank < few && sizes[rank] > least)
        rank++;
    arena_release(i, arena);
    return rank;
}

/* Count the independent rows for many coordinates, by the pivots of C C'. */
static int count_rank_of_many(Instance *i, const Rows *J)
{
    const Envelope *e = &i->scene->closing;
    const size_t arena = arena_mark(i);
    double *a = arena_alloc(i, e->entries), most = rows_squared(i, J, a);
    int rank = 0;
    envelope_factor(e, a, DBL_MIN);
    for (int r = 0; r < i->scene->l; r++)
        rank += *envelope_entry(e, a, r, r) > DEPENDENT * most;
    arena_release(i, arena);
    return rank;
}

/* Return the number of independent constraints at q. */
int rank_at(Instance *i, const double *q, const unsigned char *held)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    const Rows J = {matrix_new(i, &s->constraint), matrix_new(i, &s->tie_rows)};
    double *weights = arena_alloc(i, (size_t)s->l), *phi = arena_alloc(i, (size_t)(s->l + s->ties));
    int rank;
    memset(J.ties.values, 0, (size_t)s->tie_rows.entries * sizeof *J.ties.values);
    for (int r = 0; r < s->l; r++)
        weights[r] = held[r];
    rank_weighted_rows(i, q, weights, J.constraints, phi);
    rank = s->n > DENSE ? count_rank_of_many(i, &J) : count_rank(i, J.constraints);
    arena_release(i, arena);
    return rank;
}

/* Compute the correction of least norm that judges a rank; for few coordinates it includes motions C hardly holds. */
void rank_correction(Instance *i, const Rows *J, const double *r, double *x)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *C;
    if (s->n > DENSE) {
        rows_least_correction(i, J, r, CORRECTIONS, x);
        return;
    }
    C = arena_alloc(i, (size_t)s->l * (size_t)s->n);
    pattern_spread(J->constraints.pattern, J->constraints.values, C, s->l);
    linear_least_norm(s->l, s->n, C, r, 1e-8, x, arena_alloc(i, linear_least_norm_work(s->l, s->n)));
    arena_release(i, arena);
}

/* S1: return the degrees of freedom at regular positions near q, in `here` those at q, in `place` one of these
   positions. */
int rank_freedom_near(Instance *i, const double *q, const unsigned char *held, int *here, double *place)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n, l = (size_t)s->l, count = l + (size_t)s->ties;
    const int many = s->n > DENSE, places = many ? FEW_RANKED : RANKED;
    const double size = 0.3 * fmin(fmax(1.0, instance_largest(i, q)), ALIKE) / sqrt(s->n);
    const Rows J = {matrix_new(i, &s->constraint), matrix_new(i, &s->tie_rows)};
    const Matrix C = J.constraints;
    double *phi = arena_alloc(i, count), *weights = arena_alloc(i, l), *units = arena_alloc(i, l),
           *near = arena_alloc(i, n), *dq = arena_alloc(i, n);
    double *side_places = arena_alloc(i, n), most = 1.0;
    int rank, found;
    memset(J.ties.values, 0, (size_t)s->tie_rows.entries * sizeof *J.ties.values);
    memset(phi, 0, count * sizeof *phi);
    for (int r = 0; r < s->l; r++) {
        weights[r] = held[r];
        units[r] = 0.0;
    }
    for (int k = -1; k < places && !many; k++) { /* Scale rows by their size, so that units do not affect the rank. */
        for (int c = 0; c < s->n; c++)
            near[c] = q[c]
                + (k < 0 ? 0.0 : size * (coordinate_is_length(s, c) ? *i->length : 1.0) * s->normal[k * s->n + c]);
        rank_weighted_rows(i, near, weights, C, phi);
        for (int e = 0; e < s->constraint.entries; e++)
            units[s->constraint.indices[e]] = fmax(units[s->constraint.indices[e]], fabs(C.values[e]));
    }
    most = fmax(most, linear_largest(units, s->l));
    for (int r = 0; r < s->l; r++) /* Do not scale up a row of round-off. */
        weights[r] = held[r] / (units[r] > SAME * most ? units[r] : 1.0);
    rank_weighted_rows(i, q, weights, C, phi);
    rank = many ? count_rank_of_many(i, &J) : count_rank(i, C);
    *here = s->n - rank;
    memcpy(place, q, n * sizeof *q);
    for (int k = 0; k < places; k++) {
        for (int c = 0; c < s->n; c++)
            side_places[c] = size * (coordinate_is_length(s, c) ? *i->length : 1.0) * s->normal[k * s->n + c];
        if (many) { /* Displace along the motion: in a long chain any other displacement leads far from an assembly. */
            double most;
            rank_weighted_rows(i, q, weights, C, phi);
            matrix_times(C, side_places, phi);
            rows_least_correction(i, &J, phi, CORRECTIONS, dq);
            for (int c = 0; c < s->n; c++)
                side_places[c] -= dq[c];
            most = fmax(instance_largest(i, side_places), 1e-300);
            for (int c = 0; c < s->n; c++)
                side_places[c] *= 0.3 / most;
        }
        for (int c = 0; c < s->n; c++)
            near[c] = q[c] + side_places[c];
        if (s->timed) /* With time fixed, a prescribed motion may have no regular position. */
            near[s->n - 1] += (k % 2 ? -LATER : LATER) * pow(0.1, (k / 2) % 4);
        for (int pass = 0;; pass++) {
            rank_weighted_rows(i, near, weights, C, phi);
            if (pass == 30 || linear_largest(phi, s->l) <= 1e-16 * linear_largest(near, s->n))
                break;
            rank_correction(i, &J, phi, dq);
            for (int c = 0; c < s->n; c++)
                near[c] -= dq[c];
        }
        for (int c = 0; c < s->n; c++)
            dq[c] = (near[c] - q[c]) / (coordinate_is_length(s, c) ? *i->length : 1.0);
        /* Contradictory constraints may close at places far away alone. */
        if (linear_largest(phi, s->l) < 1e-9 && linear_norm(dq, s->n) < 3.0 * size * sqrt(s->n)
            && (found = many ? count_rank_of_many(i, &J) : count_rank(i, C)) > rank) {
            rank = found;
            memcpy(place, near, n * sizeof *near);
        }
    }
    arena_release(i, arena);
    return s->n - rank;
}

/* S5: find orthonormal columns (l x n) that span those of C at q, each row times the root of its penalty. */
static void span_rows(Instance *i, const double *q, double *span, double *sizes)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n;
    const Matrix C = matrix_new(i, &s->constraint);
    double *zeros = arena_alloc(i, n);
    memset(zeros, 0, n * sizeof *zeros);
    memset(span, 0, n * (size_t)s->l * sizeof *span);
    constraints_evaluate(i, q, zeros, NULL, C.values, NULL, NULL);
    for (int c = 0; c < s->n; c++)
        for (int e = C.pattern->offsets[c]; e < C.pattern->offsets[c + 1]; e++)
            span[c * s->l + C.pattern->indices[e]] = sqrt(i->penalty[C.pattern->indices[e]]) * C.values[e];
    linear_span(s->l, s->n, (int)*i->rank, span, sizes);
    arena_release(i, arena);
}

/* S5: return whether constraints that are redundant at q become independent at a displacement along `way`, and would
   stop that motion. */
static int rank_changes_along(Instance *i, const double *q, const double *way)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n, l = (size_t)s->l;
    const int rank = (int)*i->rank;
    const Matrix C = matrix_new(i, &s->constraint);
    double *span = arena_alloc(i, l * n), *sizes = arena_alloc(i, n), *there = arena_alloc(i, n), found = 0.0;
    double *column = arena_alloc(i, l);
    span_rows(i, q, span, sizes);
    for (int c = 0; c < s->n; c++)
        there[c] = q[c] + side_places[SIDE_PLACES - 1] * way[c];
    constraints_evaluate(i, there, way, NULL, C.values, NULL, NULL);
    for (int c = 0; c < s->n; c++) {
        memset(column, 0, l * sizeof *column);
        for (int e = C.pattern->offsets[c]; e < C.pattern->offsets[c + 1]; e++)
            column[C.pattern->indices[e]] = sqrt(i->penalty[C.pattern->indices[e]]) * C.values[e];
        linear_orthogonalise_to(span, rank, s->l, column);
        found = fmax(found, linear_norm(column, s->l));
    }
    arena_release(i, arena);
    return sizes[rank - 1] >= REGULAR * sizes[0] && found > REGULAR * REGULAR * REGULAR * sizes[0];
}

/* Return whether this happens for a motion at a position near the start. */
int rank_changes_near(Instance *i, const double *q, const double *v)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n, count = (size_t)(s->l + s->ties);
    Rows J;
    double *way, *weights, *phi, *near, *dq, size;
    int active = 0, found = 0, from, to;
    for (int r = 0; r < s->l; r++)
        active += i->penalty[r] > 0.0;
    if (*i->rank >= active || *i->rank < 1.0 || s->n > DENSE)
        return 0;
    J = (Rows){matrix_new(i, &s->constraint), matrix_new(i, &s->tie_rows)};
    way = arena_alloc(i, n);
    near = arena_alloc(i, n);
    dq = arena_alloc(i, n);
    phi = arena_alloc(i, count);
    weights = arena_alloc(i, (size_t)s->l);
    memset(phi, 0, count * sizeof *phi);
    memset(J.ties.values, 0, (size_t)s->tie_rows.entries * sizeof *J.ties.values);
    for (int r = 0; r < s->l; r++)
        weights[r] = i->penalty[r] > 0.0;
    /* Try the motion at the start first; of several degrees of freedom a random one, too: a loop may rest on a moving
       base. */
    from = linear_largest(v, s->n) > 0.0 ? 0 : SIDE_PLACES;
    to = from == 0 && (int)*i->rank >= s->n - 1 ? SIDE_PLACES : 2 * SIDE_PLACES;
    for (int a = from; a < to && !found; a++) {
        if (a % SIDE_PLACES == 0) {
            memcpy(way, v, n * sizeof *way);
            if (a > 0) {
                rank_weighted_rows(i, q, weights, J.constraints, phi);
                matrix_times(J.constraints, s->normal, phi);
                rows_least_correction(i, &J, phi, CORRECTIONS, dq);
                for (int c = 0; c < s->n; c++)
                    way[c] = s->normal[c] - dq[c];
            }
            size = fmax(instance_largest(i, way), 1e-300);
            for (int c = 0; c < s->n; c++)
                way[c] /= size;
        }
        for (int c = 0; c < s->n; c++)
            near[c] = q[c] + side_places[a % SIDE_PLACES] * way[c];
        for (int pass = 0; pass <= CORRECTIONS; pass++) {
            rank_weighted_rows(i, near, weights, J.constraints, phi);
            if (pass == CORRECTIONS || linear_largest(phi, s->l) <= TOLERANCE)
                break;
            rows_least_correction(i, &J, phi, CORRECTIONS, dq);
            for (int c = 0; c < s->n; c++)
                near[c] -= dq[c];
        }
        found = linear_largest(phi, s->l) <= GROSS && rank_changes_along(i, near, way);
    }
    arena_release(i, arena);
    return found;
}

/* S5: freeze the rank of C at the state before a step. */
void rank_freeze(Instance *i)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n, l = (size_t)s->l;
    const int rank = (int)*i->rank;
    double *span, *sizes, *roots, *matrix = instance_field(i, s->k) + scene_matrix(s);
    if (!s->brakes || rank < 1 || rank > s->l || rank > s->n || s->n > DENSE)
        return;
    span = arena_alloc(i, n * l);
    sizes = arena_alloc(i, n);
    roots = arena_alloc(i, l);
    for (int r = 0; r < s->l; r++)
        roots[r] = sqrt(i->penalty[r]);
    span_rows(i, instance_field(i, s->z), span, sizes);
    /* S5: at a singular position keep the combinations of the previous regular one. */
    if (sizes[rank - 1] > REGULAR * sizes[0]) {
        for (int a = 0; a < s->l; a++)
            for (int b = 0; b <= a; b++) { /* the sum is the same for both entries */
                double sum = 0.0;
                for (int k = 0; k < rank; k++)
                    sum += span[k * s->l + a] * span[k * s->l + b];
                matrix[a * s->l + b] = roots[a] * sum * roots[b] / *i->largest_penalty;
                matrix[b * s->l + a] = roots[b] * sum * roots[a] / *i->largest_penalty;
            }
        tape_holding(i, instance_field(i, s->z), matrix);
    }
    arena_release(i, arena);
}

/* Count the degrees of freedom and redundant constraints of the rows in force, of all rows, or of the rows in force
   without those of dry friction; `place` (n) becomes a nearby position with the largest rank. */
Outcome instance_mobility(Instance *i, Counted_rows which, int *freedom, int *redundant, int *here, double *place)
{
    const Scene *s = i->scene;
    unsigned char *held;
    arena_reset(i);
    memcpy(place, instance_field(i, s->z), (size_t)s->n * sizeof *place);
    *freedom = *here = scene_coordinates(s);
    *redundant = 0;
    if (!i->flags.initialized)
        return instance_say(i, REFUSED, "%s: its degrees of freedom are known after initialising", s->name);
    if (!s->l)
        return DONE;
    held = (unsigned char *)arena_alloc(i, (size_t)s->l);
    for (int r = 0; r < s->l; r++)
        held[r] = which == ALL_ROWS || i->penalty[r] > 0.0;
    for (int k = 0; k < s->frictions && which == NO_FRICTION; k++)
        held[s->friction[k].row] = 0;
    for (int r = 0; r < s->l; r++)
        *redundant += held[r];
    *freedom = rank_freedom_near(i, instance_field(i, s->z), held, here, place) - s->timed;
    *here -= s->timed;
    *redundant -= scene_coordinates(s) - *freedom;
    arena_reset(i);
    return DONE;
}
