#include "loops.h"

#include <stdio.h>

#include "equations.h"
#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "least_squares.h"
#include "linear.h"
#include "quantity.h"
#include "record.h"
#include "scene.h"
#include "text.h"

/* Weight of a coordinate that least squares leave alone: corrections in proportion to its square are zero. */
#define STANDS_STILL 1e-200

const double *loops_starts(const Instance *i)
{
    return i->values + i->scene->own;
}

/* Evaluate residue and matrix at q. */
void loops_evaluate(Instance *i, Loops *loops, const double *q)
{
    const Scene *s = i->scene;
    const double *x[] = {q, instance_field(i, s->p), loops_starts(i)};
    double *y[] = {loops->J.constraints.values, loops->J.ties.values, loops->residue, loops->residue + s->l};
    function_call(i, s->closure, x, y);
    if (loops->untied) {
        memset(loops->residue + s->l, 0, (size_t)s->ties * sizeof *loops->residue);
        memset(loops->J.ties.values, 0, (size_t)s->tie_rows.entries * sizeof *loops->J.ties.values);
    }
    for (int r = 0; r < s->l; r++)
        loops->residue[r] = loops->held[r] ? loops->residue[r] : 0.0;
    for (int e = 0; e < s->gaps.entries; e++)
        if (!loops->held[s->gaps.indices[e]])
            loops->J.constraints.values[e] = 0.0;
}

/* Return whether row k is in metres. Rows are the gaps of the loops, then the start values. */
static int row_is_length(const Scene *s, int k)
{
    return !strcmp(k < s->l ? s->rows[k].unit : s->variables[s->own + s->tied[k - s->l]].unit, "m");
}

/* Prepare the loops. Their unit of length is that of the mechanism, so that a start which nothing determines scales
   with it; the derivatives of the start take it as constant. */
Loops loops_new(Instance *i, const unsigned char *held, double length)
{
    const Scene *s = i->scene;
    Loops loops = {held, s->l + s->ties, 0, {matrix_new(i, &s->gaps), matrix_new(i, &s->tie_rows)}, NULL, NULL, NULL,
        NULL, NULL};
    loops.residue = arena_alloc(i, (size_t)loops.count);
    loops.trial = arena_alloc(i, (size_t)s->n);
    loops.rows = arena_alloc(i, (size_t)loops.count);
    loops.columns = arena_alloc(i, (size_t)s->n);
    loops.units = arena_alloc(i, (size_t)s->n);
    for (int k = 0; k < loops.count; k++)
        loops.rows[k] = (k >= s->l || held[k]) / (row_is_length(s, k) ? length : 1.0);
    for (int c = 0; c < s->n; c++) {
        loops.units[c] = coordinate_is_length(s, c) ? length : 1.0;
        loops.columns[c] = s->readiness[c] * loops.units[c];
    }
    if (s->timed) /* Time is not corrected, but its rate is part of the start rates of motions by laws of time. */
        loops.columns[s->n - 1] = STANDS_STILL;
    return loops;
}

/* Return whether the residue is below this share of the coordinates. */
static int loops_within(const Instance *i, const Loops *loops, const double *q, double share)
{
    double found = 0.0;
    for (int k = 0; k < loops->count; k++)
        found = fmax(found, fabs(loops->residue[k]) / (row_is_length(i->scene, k) ? *i->length : 1.0));
    return found <= share * fmax(1.0, instance_largest(i, q));
}

int loops_close(Instance *i, Loops *loops, const double *q)
{
    loops_evaluate(i, loops, q);
    return loops_within(i, loops, q, ROUGH);
}

/* Return the norm of the weighted residue. */
static double loops_size(const Loops *loops)
{
    double square = 0.0;
    for (int k = 0; k < loops->count; k++)
        square += pow(loops->rows[k] * loops->residue[k], 2);
    return sqrt(square);
}

/* Make Gauss-Newton steps of least weighted norm from q until they gain no more; return the length of the first one. */
double loops_follow(Instance *i, Loops *loops, double *q)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *dq = arena_alloc(i, (size_t)s->n), *lam = arena_alloc(i, (size_t)loops->count), first = -1.0;
    loops_evaluate(i, loops, q);
    for (int k = 0; k < MOST; k++) {
        const double size = loops_size(loops);
        double turned = 1e-300, part;
        if (loops_within(i, loops, q, TOLERANCE))
            break;
        matrix_weigh(loops->J.constraints, loops->rows, loops->columns);
        matrix_weigh(loops->J.ties, loops->rows + s->l, loops->columns);
        for (int r = 0; r < loops->count; r++)
            loops->residue[r] *= loops->rows[r];
        rows_least_multipliers(i, &loops->J, loops->residue, CORRECTIONS, lam, dq);
        if (first < 0.0)
            first = linear_norm(dq, s->n);
        for (int c = 0; c < s->n; c++)
            if (!strcmp(s->coordinates[c].unit, "rad"))
                turned = fmax(turned, fabs(loops->columns[c] * dq[c]));
        for (part = fmin(1.0, LONGEST_TURN / turned); part > 1e-4; part /= 2) {
            for (int c = 0; c < s->n; c++)
                loops->trial[c] = q[c] - part * loops->columns[c] * dq[c];
            loops_evaluate(i, loops, loops->trial);
            if (loops_size(loops) < (1 - part / 10) * size)
                break;
        }
        if (part <= 1e-4)
            break;
        tape_correction(i, loops->rows, loops->columns, q, NULL, dq, lam, part);
        memcpy(q, loops->trial, (size_t)s->n * sizeof *q);
    }
    arena_release(i, arena);
    return fmax(first, 0.0);
}

/* Return a change of a coordinate; for an angle, without whole turns. */
double coordinate_shortest_way(const Scene *s, int coordinate, double change)
{
    return strcmp(s->coordinates[coordinate].unit, "rad") ? change : remainder(change, 4 * QUARTER);
}

/* Return the distance between two positions, in units of each coordinate and without whole turns. */
double coordinates_apart(const Scene *s, const double *units, const double *from, const double *to)
{
    double square = 0.0;
    for (int c = 0; c < s->n; c++)
        square += pow(coordinate_shortest_way(s, c, to[c] - from[c]) / units[c], 2);
    return sqrt(square);
}

/* Compute the k-th position beside the guess from which an assembly is searched. */
void loops_beside_guess(
    const Instance *i, const Loops *loops, const double *guess, double size, int k, double *q)
{
    const Scene *s = i->scene;
    for (int c = 0; c < s->n; c++)
        q[c] = guess[c]
            + loops->units[c] * size * (0.2 + 1.3 * k / (TRIES - 1)) * s->normal[k * s->n + c] / sqrt(s->n);
}

/* Name the widest gap, or the start value that is missed most. */
const char *loops_gap_label(Instance *i, const Loops *loops, char *label, size_t size)
{
    const Scene *s = i->scene;
    int worst = 0;
    for (int k = 1; k < loops->count; k++)
        if (fabs(loops->residue[k]) * loops->rows[k] > fabs(loops->residue[worst]) * loops->rows[worst])
            worst = k;
    if (worst < s->l) {
        double gap = 0.0;
        for (int r = 0; r < s->l; r++)
            if (!strcmp(s->rows[r].name, s->rows[worst].name))
                gap += loops->residue[r] * loops->residue[r];
        write_text(label, size, "a gap of %.3g %s at %s", sqrt(gap), s->rows[worst].unit, s->rows[worst].name);
    } else {
        const Variable *start = s->variables + s->own + s->tied[worst - s->l];
        char left[QUANTITY];
        snprintf(label, size, "%s missed by %s", start->name,
            quantity_in_unit(start->unit, fabs(loops->residue[worst]), left));
    }
    return label;
}

/* Return the weighted distance between two positions; `most` becomes the coordinate that differs most. */
double loops_way(const Instance *i, const Loops *loops, const double *from, const double *to, int *most)
{
    double square = 0.0, longest = 0.0;
    *most = 0;
    for (int c = 0; c < i->scene->n; c++) {
        const double change = (to[c] - from[c]) / loops->columns[c];
        square += change * change;
        if (fabs(to[c] - from[c]) > longest * loops->units[c]) {
            longest = fabs(to[c] - from[c]) / loops->units[c];
            *most = c;
        }
    }
    return sqrt(square);
}
