#include "loops.h"

#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

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

const double *loops_starts(const Instance *i)
{
    return i->values + i->scene->own;
}

/* Residue and matrix at q. */
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

Loops loops_new(Instance *i, const unsigned char *held)
{
    const Scene *s = i->scene;
    Loops loops = {held, s->l + s->ties, 0, {matrix_new(i, &s->gaps), matrix_new(i, &s->tie_rows)}, NULL, NULL};
    loops.residue = arena_alloc(i, (size_t)loops.count);
    loops.trial = arena_alloc(i, (size_t)s->n);
    return loops;
}

/* Return whether the residue is below this share of the coordinates; gaps in metres are relative to the length of
   the mechanism. */
static int loops_within(const Instance *i, const Loops *loops, const double *q, double share)
{
    const Scene *s = i->scene;
    double found = 0.0;
    for (int k = 0; k < loops->count; k++)
        found = fmax(found, fabs(loops->residue[k]) / (k < s->l && !strcmp(s->rows[k].unit, "m") ? *i->length : 1.0));
    return found <= share * fmax(1.0, instance_largest(i, q));
}

int loops_close(Instance *i, Loops *loops, const double *q)
{
    loops_evaluate(i, loops, q);
    return loops_within(i, loops, q, ROUGH);
}

/* Gauss-Newton steps of least norm from q to where they end; the length of the first one. */
double loops_follow(Instance *i, Loops *loops, double *q)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *dq = arena_alloc(i, (size_t)s->n), *lam = arena_alloc(i, (size_t)loops->count), first = -1.0;
    loops_evaluate(i, loops, q);
    for (int k = 0; k < MOST; k++) {
        double size = linear_norm(loops->residue, loops->count), turned = 1e-300, part;
        if (loops_within(i, loops, q, TOLERANCE))
            break;
        rows_least_multipliers(i, &loops->J, loops->residue, CORRECTIONS, lam, dq);
        if (first < 0.0)
            first = linear_norm(dq, s->n);
        for (int c = 0; c < s->n; c++)
            if (!strcmp(s->coordinates[c].unit, "rad"))
                turned = fmax(turned, fabs(dq[c]));
        for (part = fmin(1.0, LONGEST_TURN / turned); part > 1e-4; part /= 2) {
            for (int c = 0; c < s->n; c++)
                loops->trial[c] = q[c] - part * dq[c];
            loops_evaluate(i, loops, loops->trial);
            if (linear_norm(loops->residue, loops->count) < (1 - part / 10) * size)
                break;
        }
        if (part <= 1e-4)
            break;
        tape_closing(i, loops->held, q, dq, lam, part);
        memcpy(q, loops->trial, (size_t)s->n * sizeof *q);
    }
    arena_release(i, arena);
    return fmax(first, 0.0);
}

/* A change of a coordinate, of an angle by at most half a turn. */
double coordinate_shortest_way(const Scene *s, int coordinate, double change)
{
    return strcmp(s->coordinates[coordinate].unit, "rad") ? change : remainder(change, 4 * QUARTER);
}

/* The length of the shortest way from one place to another. */
double coordinates_apart(const Scene *s, const double *from, const double *to)
{
    double square = 0.0;
    for (int c = 0; c < s->n; c++)
        square += pow(coordinate_shortest_way(s, c, to[c] - from[c]), 2);
    return sqrt(square);
}

/* A place beside the guess from which an assembly is looked for, the k-th of them. */
void loops_beside_guess(const Scene *s, const double *guess, double size, int k, double *q)
{
    for (int c = 0; c < s->n; c++)
        q[c] = guess[c] + size * (0.2 + 1.3 * k / (TRIES - 1)) * s->normal[k * s->n + c] / sqrt(s->n);
}

/* The widest gap, or the start value that is missed most. */
const char *loops_gap_label(Instance *i, const Loops *loops, char *label, size_t size)
{
    const Scene *s = i->scene;
    int worst = 0;
    for (int k = 1; k < loops->count; k++)
        if (fabs(loops->residue[k]) > fabs(loops->residue[worst]))
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

/* The length of the way from one place to another, and the coordinate that changes most on it. */
double coordinates_way(const Scene *s, const double *from, const double *to, int *most)
{
    double square = 0.0;
    *most = 0;
    for (int c = 0; c < s->n; c++) {
        square += (to[c] - from[c]) * (to[c] - from[c]);
        if (fabs(to[c] - from[c]) > fabs(to[*most] - from[*most]))
            *most = c;
    }
    return sqrt(square);
}
