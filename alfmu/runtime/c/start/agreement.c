#include "agreement.h"

#include <stdio.h>

#include "equations.h"
#include "instance.h"
#include "layout.h"
#include "least_squares.h"
#include "linear.h"
#include "message.h"
#include "rank.h"
#include "scene.h"

/* Ratio of what redundant constraints leave open along the motion to what they do at the start [1], at most. */
#define VARIES 4.0

/* Compute the residues (l) that first-order corrections leave in the constraints in force. */
static void find_uncorrectable(Instance *i, const Rows *J, const double *r, double *left)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *dq = arena_alloc(i, (size_t)s->n);
    rows_least_correction(i, J, r, CORRECTIONS, dq);
    rows_times(J, dq, left);
    for (int k = 0; k < s->l; k++)
        left[k] = r[k] - left[k];
    arena_release(i, arena);
}

/* Return how far the constraints lead back a position that is displaced along a motion, over the displacement. */
static double find_restoring_share(
    Instance *i, const Rows *J, const double *weights, const double *q, const double *way, double size)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *near = arena_alloc(i, (size_t)s->n), *dq = arena_alloc(i, (size_t)s->n),
           *phi = arena_alloc(i, (size_t)(s->l + s->ties)), found;
    memset(phi, 0, (size_t)(s->l + s->ties) * sizeof *phi);
    for (int c = 0; c < s->n; c++)
        near[c] = q[c] + size * way[c];
    for (int pass = 0; pass < MOST_RETURNS; pass++) {
        rank_weighted_rows(i, near, weights, J->constraints, phi);
        rank_correction(i, J, phi, dq);
        for (int c = 0; c < s->n; c++)
            near[c] -= dq[c];
    }
    for (int c = 0; c < s->n; c++)
        near[c] -= q[c] + size * way[c];
    found = instance_largest(i, near) / size;
    arena_release(i, arena);
    return found;
}

/* List the joints of the rows with most of a residue (l). */
static void list_joints(const Scene *s, const double *residue, char *names, size_t size)
{
    int said = 0;
    for (int r = 0, other; r < s->l; r++) {
        if (fabs(residue[r]) < 0.1 * linear_largest(residue, s->l))
            continue;
        for (other = 0; other < r; other++)
            if (!strcmp(s->rows[other].name, s->rows[r].name)
                && fabs(residue[other]) >= 0.1 * linear_largest(residue, s->l))
                break;
        if (other == r && said++ < SAID)
            snprintf(names + strlen(names), size - strlen(names), "%s%.40s", *names ? ", " : "", s->rows[r].name);
    }
}

/* Return whether redundant constraints can be judged at q, which must not be singular. */
static int is_regular_place(Instance *i, const unsigned char *held, const double *q)
{
    const Scene *s = i->scene;
    int active = 0;
    for (int r = 0; r < s->l; r++)
        active += held[r];
    return *i->rank < active && s->n <= DENSE && rank_at(i, q, held) == (int)*i->rank;
}

/* Return DONE, or report which constraints contradict each other, judged by the residue |Phi|, or |Phi-dot| at
   velocities v, that first-order corrections leave at a regular position. Store the norm of what positions leave, in
   units of each row, as no step can close it. */
Outcome agreement_check(
    Instance *i, const unsigned char *held, const double *q, const double *v, const double *open)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), count = (size_t)(s->l + s->ties);
    const Rows J = {matrix_new(i, &s->constraint), matrix_new(i, &s->tie_rows)};
    double *weights = arena_alloc(i, (size_t)s->l), *residue = arena_alloc(i, count), *left = arena_alloc(i, count),
           *limits = arena_alloc(i, (size_t)s->l);
    double together = 0.0;
    int row = 0, gaps = 0;
    char names[300] = "";
    Outcome outcome = DONE;
    memset(J.ties.values, 0, (size_t)s->tie_rows.entries * sizeof *J.ties.values);
    memset(residue, 0, count * sizeof *residue);
    for (int r = 0; r < s->l; r++)
        weights[r] = held[r];
    rank_weighted_rows(i, q, weights, J.constraints, left);
    for (int r = 0; r < s->l; r++)
        residue[r] = weights[r] * open[r];
    if (is_regular_place(i, held, q)) {
        find_uncorrectable(i, &J, residue, left);
        constraints_limits(i, J.constraints.values, q, v, limits);
        for (int r = 0; r < s->l; r++) {
            gaps |= fabs(residue[r]) > limits[r];
            together = hypot(together, left[r] / i->units[r]);
            row = fabs(left[r]) / limits[r] > fabs(left[row]) / limits[row] ? r : row;
        }
        if (!v)
            *i->agreed = VARIES * together;
        if (fabs(left[row]) > limits[row] && gaps) {
            list_joints(s, left, names, sizeof names);
            outcome = instance_say(i, FAILED,
                "%s: constraints contradict each other: %s cannot be kept together, and %s is violated by %.3g %s%s; "
                "make their lengths, offsets and laws agree, or leave one of them out",
                s->name, names, s->rows[row].name, fabs(left[row]), s->rows[row].unit, v ? "/s" : "");
        }
    }
    arena_release(i, arena);
    return outcome;
}

/* Warn of constraints that stop a motion at every position, but only to second order: displaced along the motion they
   lead back, by a share that does not fall with the displacement. */
void agreement_warn_of_second_order(Instance *i, const unsigned char *held, const double *q)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n, count = (size_t)(s->l + s->ties);
    const Rows J = {matrix_new(i, &s->constraint), matrix_new(i, &s->tie_rows)};
    const Matrix C = matrix_new(i, &s->constraint);
    double *weights = arena_alloc(i, (size_t)s->l), *left = arena_alloc(i, count), *gap = arena_alloc(i, count),
           *way = arena_alloc(i, n), *dq = arena_alloc(i, n);
    double size, back = 0.0;
    char names[300] = "";
    if (!is_regular_place(i, held, q)) {
        arena_release(i, arena);
        return;
    }
    memset(J.ties.values, 0, (size_t)s->tie_rows.entries * sizeof *J.ties.values);
    memset(left, 0, count * sizeof *left);
    memset(gap, 0, count * sizeof *gap);
    for (int r = 0; r < s->l; r++)
        weights[r] = held[r];
    rank_weighted_rows(i, q, weights, J.constraints, left);
    for (int c = 0; c < s->n; c++)
        way[c] = (coordinate_is_length(s, c) ? *i->length : 1.0) * s->normal[c];
    matrix_times(J.constraints, way, left);
    rank_correction(i, &J, left, dq);
    for (int c = 0; c < s->n; c++)
        way[c] -= dq[c];
    size = instance_largest(i, way);
    for (int c = 0; c < s->n; c++)
        way[c] /= fmax(size, 1e-300);
    if (size > REGULAR)
        back = find_restoring_share(i, &J, weights, q, way, LITTLE);
    /* For a possible motion this share falls with the displacement. */
    if (back > SECOND_ORDER && back > 0.5 * find_restoring_share(i, &J, weights, q, way, 10 * LITTLE)) {
        for (int c = 0; c < s->n; c++)
            dq[c] = q[c] + LITTLE * way[c];
        rank_weighted_rows(i, q, weights, J.constraints, left);
        rank_weighted_rows(i, dq, weights, C, gap);
        find_uncorrectable(i, &J, gap, left);
        list_joints(s, left, names, sizeof names);
        instance_warn(i, WARNED_OF_SECOND_ORDER,
            "%s: %s stop a motion to second order only, in every position: no finite force does, so results are "
            "unreliable if a load acts on it; change lengths or offsets, or leave out the constraint that only this "
            "motion needs",
            s->name, names);
    }
    arena_release(i, arena);
}
