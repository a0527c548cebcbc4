/* The start of a run, as assembly.py, scaling.py and oracle.py have it: loops closed from a guess, velocities
   made consistent, massless bodies checked, penalties scaled, what tells a singular position found out. */

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "alfmu.h"
#include "linear.h"

/* What an assembly closes: the gaps of the rows that are held, and the start values. */
typedef struct {
    const unsigned char *held;
    int count; /* of both */
    double *gaps, *ties, *matrix, *residue, *trial;
} Loops;

static const double *starts(const Instance *i)
{
    return i->values + i->scene->own;
}

/* Residue and matrix at q. */
static void closure_at(Instance *i, Loops *loops, const double *q)
{
    const Scene *s = i->scene;
    const double *x[] = {q, field(i, s->p), starts(i)};
    const size_t used = i->used;
    double *gaps = take(i, (size_t)s->gaps.entries), *ties = take(i, (size_t)s->tie_rows.entries);
    double *y[] = {gaps, ties, loops->residue, loops->residue + s->l};
    call(i, s->closure, x, y);
    spread(&s->gaps, gaps, loops->gaps);
    spread(&s->tie_rows, ties, loops->ties);
    for (int r = 0; r < s->l; r++)
        if (!loops->held[r]) {
            loops->residue[r] = 0.0;
            for (int c = 0; c < s->n; c++)
                loops->gaps[c * s->l + r] = 0.0;
        }
    for (int c = 0; c < s->n; c++) {
        memcpy(loops->matrix + c * loops->count, loops->gaps + c * s->l, (size_t)s->l * sizeof(double));
        memcpy(loops->matrix + c * loops->count + s->l, loops->ties + c * s->ties, (size_t)s->ties * sizeof(double));
    }
    i->used = used;
}

static Loops loops_new(Instance *i, const unsigned char *held)
{
    const Scene *s = i->scene;
    const size_t l = (size_t)s->l, n = (size_t)s->n, ties = (size_t)s->ties;
    Loops loops = {held, s->l + s->ties, NULL, NULL, NULL, NULL, NULL};
    loops.gaps = take(i, l * n);
    loops.ties = take(i, ties * n);
    loops.matrix = take(i, (l + ties) * n);
    loops.residue = take(i, l + ties);
    loops.trial = take(i, n);
    return loops;
}

static int closes(Instance *i, Loops *loops, const double *q)
{
    closure_at(i, loops, q);
    return largest(loops->residue, loops->count) <= ROUGH * fmax(1.0, largest(q, i->scene->n));
}

/* Least-norm solution for a matrix with `rows` rows and n columns. */
static void solved(Instance *i, int rows, const double *matrix, const double *r, double least, double *x)
{
    const size_t used = i->used;
    least_norm(rows, i->scene->n, matrix, r, least, x, take(i, least_norm_work(rows, i->scene->n)));
    i->used = used;
}

/* Gauss-Newton steps of least norm from q to where they end; the length of the first one. */
static double followed(Instance *i, Loops *loops, double *q)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *dq = take(i, (size_t)s->n), first = -1.0;
    closure_at(i, loops, q);
    for (int k = 0; k < MOST; k++) {
        double size = norm(loops->residue, loops->count), turned = 1e-300, part;
        if (largest(loops->residue, loops->count) <= TOLERANCE * fmax(1.0, largest(q, s->n)))
            break;
        solved(i, loops->count, loops->matrix, loops->residue, 1e-10, dq);
        if (first < 0.0)
            first = norm(dq, s->n);
        for (int c = 0; c < s->n; c++)
            if (!strcmp(s->coordinates[c].unit, "rad"))
                turned = fmax(turned, fabs(dq[c]));
        for (part = fmin(1.0, LONGEST_TURN / turned); part > 1e-4; part /= 2) {
            for (int c = 0; c < s->n; c++)
                loops->trial[c] = q[c] - part * dq[c];
            closure_at(i, loops, loops->trial);
            if (norm(loops->residue, loops->count) < (1 - part / 10) * size)
                break;
        }
        if (part <= 1e-4)
            break;
        memcpy(q, loops->trial, (size_t)s->n * sizeof *q);
    }
    i->used = used;
    return fmax(first, 0.0);
}

/* The assembly nearest to the guess among those found from places around it; whether there is one. */
static int nearest(Instance *i, Loops *loops, const double *guess, double size, double *found)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *q = take(i, (size_t)s->n), best = INFINITY;
    for (int k = 0; k < TRIES; k++) {
        double away = 0.0;
        for (int c = 0; c < s->n; c++)
            q[c] = guess[c] + size * (0.2 + 1.3 * k / (TRIES - 1)) * s->normal[k * s->n + c] / sqrt(s->n);
        followed(i, loops, q);
        if (!closes(i, loops, q))
            continue;
        for (int c = 0; c < s->n; c++)
            away += (q[c] - guess[c]) * (q[c] - guess[c]);
        if (away < best) {
            best = away;
            memcpy(found, q, (size_t)s->n * sizeof *q);
        }
    }
    i->used = used;
    return best < INFINITY;
}

/* The widest gap, or the start value that is missed most. */
static const char *gap_label(Instance *i, const Loops *loops, char *label, size_t size)
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
        snprintf(label, size, "a gap of %.3g %s at %s", sqrt(gap), s->rows[worst].unit, s->rows[worst].name);
    } else {
        const Variable *start = s->variables + s->own + s->tied[worst - s->l];
        snprintf(label, size, "%s missed by %.3g %s", start->name, fabs(loops->residue[worst]), start->unit);
    }
    return label;
}

static Outcome positions(Instance *i, Loops *loops, const double *guess, double *q)
{
    const Scene *s = i->scene;
    double step, moved = 0.0, *other = take(i, (size_t)s->n);
    char label[200];
    int found;
    memcpy(q, guess, (size_t)s->n * sizeof *q);
    step = followed(i, loops, q);
    for (int c = 0; c < s->n; c++)
        moved += (q[c] - guess[c]) * (q[c] - guess[c]);
    moved = closes(i, loops, q) ? sqrt(moved) : INFINITY;
    if (moved <= 1.5 * step + 1e-6)
        return DONE;
    /* A long way, or none: is there an assembly nearer to the guess? */
    found = nearest(i, loops, guess, fmin(moved, 3.0), other);
    if (!found && moved == INFINITY) {
        closure_at(i, loops, q);
        return say(i, FAILED, "%s: %s; the nearest assembly leaves %s; %s", s->name,
            largest(loops->residue, s->l) <= ROUGH ? "the start values contradict each other"
                                                   : "the loops cannot be closed",
            gap_label(i, loops, label, sizeof label),
            s->ties > 1 ? "give fewer or consistent start values" : "check lengths, offsets and start values");
    }
    if (found) {
        double away = 0.0;
        int worst = 0;
        for (int c = 0; c < s->n; c++) {
            away += (other[c] - guess[c]) * (other[c] - guess[c]);
            if (fabs(other[c] - guess[c]) > fabs(other[worst] - guess[worst]))
                worst = c;
        }
        if (sqrt(away) < 0.99 * moved) {
            closure_at(i, loops, guess);
            return say(i, FAILED,
                "%s: the guess leaves %s and leads to an assembly elsewhere than the nearest one, where %s is %.6g %s; "
                "give start values or guesses closer to the assembly you want",
                s->name, gap_label(i, loops, label, sizeof label), s->coordinates[worst].name, other[worst],
                s->coordinates[worst].unit);
        }
    }
    return DONE;
}

/* Velocities that keep the loops closed and have the start rates, nearest to the guess v. */
static Outcome rates(Instance *i, Loops *loops, const double *q, double *v)
{
    const Scene *s = i->scene;
    const size_t n = (size_t)s->n, l = (size_t)s->l;
    const double *rate = starts(i) + s->starts;
    double *matrix = take(i, l * n), *left = take(i, (size_t)loops->count), *dv = take(i, n), *xi = take(i, l);
    double *F = take(i, n), *phi = take(i, l), *cv = take(i, l), *zeros = take(i, (size_t)s->inputs + 1);
    double *M = take(i, (size_t)s->mass.entries), *C = take(i, (size_t)s->constraint.entries), lost = 0.0, most;
    const double zero = 0.0;
    int worst = 0;
    constraints_at(i, q, v, NULL, matrix, phi, cv);
    closure_at(i, loops, q);
    for (int c = 0; c < s->n; c++)
        for (int r = 0; r < s->l; r++) {
            matrix[c * s->l + r] *= loops->held[r];
            loops->matrix[c * loops->count + r] = matrix[c * s->l + r];
        }
    for (int pass = 0; pass < 3; pass++) {
        for (int r = 0; r < loops->count; r++) {
            left[r] = r < s->l ? 0.0 : rate[s->tied[r - s->l]];
            for (int c = 0; c < s->n; c++)
                left[r] -= loops->matrix[c * loops->count + r] * v[c];
        }
        if (pass == 2)
            break;
        solved(i, loops->count, loops->matrix, left, 1e-10, dv);
        for (int c = 0; c < s->n; c++)
            v[c] += dv[c];
    }
    for (int r = 1; r < loops->count; r++)
        if (fabs(left[r]) > fabs(left[worst]))
            worst = r;
    if (!(largest(left, loops->count) <= ROUGH * fmax(1.0, largest(v, s->n))))
        return say(i, FAILED,
            "%s: no motion has the given start rates; %s is missed by %.3g per second; give the rates of fewer "
            "coordinates, or rates that belong together",
            s->name,
            worst < s->l ? s->rows[worst].name
                         : s->variables[s->own + s->starts + s->tied[worst - s->l]].name,
            fabs(left[worst]));
    if (!s->l)
        return DONE;
    {
        const double *x[] = {q, v, zeros, field(i, s->p), &zero};
        double *y[] = {M, C, F, xi};
        memset(zeros, 0, ((size_t)s->inputs + 1) * sizeof *zeros);
        call(i, s->dynamics, x, y);
    }
    for (int r = 0; r < s->l; r++)
        xi[r] *= loops->held[r];
    /* A motion keeps what C hardly holds within that times its acceleration. */
    solved(i, s->l, matrix, xi, 1e-5, dv);
    most = largest(xi, s->l);
    for (int r = 0; r < s->l; r++) {
        double open = xi[r];
        for (int c = 0; c < s->n; c++)
            open -= matrix[c * s->l + r] * dv[c];
        if (fabs(open) > lost) {
            lost = fabs(open);
            worst = r;
        }
    }
    if (lost > 1e-3 * fmax(1.0, most))
        return say(i, FAILED,
            "%s: the start is a singular position, and its rates belong to none of the motions possible there (%s "
            "would open by %.3g %s/s2); start a little beside it",
            s->name, s->rows[worst].name, lost, s->rows[worst].unit);
    return DONE;
}

Outcome assemble(Instance *i, const unsigned char *held, double *q, double *v)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *guess = take(i, (size_t)s->n);
    const double *x[] = {field(i, s->p), starts(i), starts(i) + s->starts};
    double *y[] = {guess, v};
    Loops loops = loops_new(i, held);
    Outcome outcome;
    call(i, s->guesses, x, y);
    if (!isfinite(norm(guess, s->n)))
        outcome = say(
            i, FAILED, "%s: the start guess is not finite; check the dimensions and start values", s->name);
    else
        outcome = positions(i, &loops, guess, q);
    if (outcome == DONE)
        outcome = rates(i, &loops, q, v);
    i->used = used;
    return outcome;
}

Outcome check_masses(Instance *i, const double *q, const unsigned char *held)
{
    const Scene *s = i->scene;
    const int rows = s->n + s->l;
    const size_t used = i->used, n = (size_t)s->n, l = (size_t)s->l;
    double *M = take(i, n * n), *C = take(i, l * n), *both = take(i, (size_t)rows * n), *V = take(i, n * n);
    double *sizes = take(i, n), *zeros = take(i, n), scale;
    Outcome outcome = DONE;
    memset(zeros, 0, n * sizeof *zeros);
    constraints_at(i, q, zeros, M, C, NULL, NULL);
    scale = s->l ? fmax(largest(M, s->n * s->n), 1e-300) : 1.0;
    for (int c = 0; c < s->n; c++) {
        for (int r = 0; r < s->n; r++)
            both[c * rows + r] = M[c * s->n + r] / scale;
        for (int r = 0; r < s->l; r++)
            both[c * rows + s->n + r] = C[c * s->l + r] * held[r];
    }
    singular_values(rows, s->n, both, V, sizes);
    if (!(sizes[s->n - 1] > 1e-13)) {
        char free[300] = "";
        for (int c = 0; c < s->n; c++)
            if (fabs(V[(s->n - 1) * s->n + c]) > 0.1 && strlen(free) < 200) {
                strcat(free, *free ? ", " : "");
                strncat(free, s->coordinates[c].name, 80);
            }
        outcome = say(i, UNHELD,
            "%s: the motion along %s has no mass and no constraint that holds it (singular value %.0e of [M; C] at the "
            "start); a massless body must be held by constraints at both ends: never the last body of an open chain, "
            "never one placed by a joint coordinate alone",
            s->name, free, sizes[s->n - 1]);
    }
    i->used = used;
    return outcome;
}

static int metres(const Scene *s, int coordinate)
{
    return !strcmp(s->coordinates[coordinate].unit, "m");
}

static int radians(const Scene *s, int coordinate)
{
    return !strcmp(s->coordinates[coordinate].unit, "rad");
}

/* S1: displacements to places beside the start, the start first. */
static const double aside[] = {0.0, ASIDE};
#define PLACES (int)(sizeof aside / sizeof *aside)

/* A number at several places: at the start, least and largest. */
typedef struct {
    double first, least, most;
} Range;

static void widen(Range *range, double x)
{
    if (range->least > range->most)
        range->first = x;
    range->least = fmin(range->least, x);
    range->most = fmax(range->most, x);
}

static int alike(Range range)
{
    return range.most - range.least <= SAME * range.most;
}

/* Coefficients of C at several places: as they are, and of angles also with a quarter turn of their own. */
static void coefficients(Instance *i, const double *q, double *M, Range *sizes, Range *amplitudes)
{
    const Scene *s = i->scene;
    const size_t used = i->used, n = (size_t)s->n, entries = (size_t)s->l * n;
    double *C = take(i, entries), *turned = take(i, entries), *own = take(i, entries);
    double *there = take(i, n), *zeros = take(i, n);
    memset(zeros, 0, n * sizeof *zeros);
    for (size_t e = 0; e < entries; e++)
        sizes[e] = amplitudes[e] = (Range){0.0, INFINITY, 0.0};
    for (int k = 0; k < PLACES; k++) {
        for (int c = 0; c < s->n; c++)
            there[c] = q[c] + aside[k] * s->normal[c] * (metres(s, c) ? LITTLE : 1.0);
        constraints_at(i, there, zeros, k ? NULL : M, C, NULL, NULL);
        memset(own, 0, entries * sizeof *own);
        for (int c = 0; c < s->n && s->n <= DENSE; c++) {
            const double kept = there[c];
            if (!radians(s, c))
                continue;
            there[c] += QUARTER;
            constraints_at(i, there, zeros, NULL, turned, NULL, NULL);
            memcpy(own + c * s->l, turned + c * s->l, (size_t)s->l * sizeof *own);
            there[c] = kept;
        }
        for (size_t e = 0; e < entries; e++) {
            widen(sizes + e, fabs(C[e]));
            widen(amplitudes + e, hypot(C[e], own[e]));
        }
    }
    i->used = used;
}

/* What some coefficients of a row come to together. */
typedef struct {
    double squares;
    int count;
} Sum;

static double together(Sum sum)
{
    return sqrt(sum.squares / (sum.count > 1 ? sum.count : 1));
}

/* The unit of a row, 0 where it has no coefficient: `exact` and `angular` where it is known as such; whether it is. */
static int unit_of(const Scene *s, int r, const Range *sizes, const Range *amplitudes, double *unit, double *exact,
    double *angular)
{
    Sum lengths = {0.0, 0}, euler = {0.0, 0};
    *unit = *exact = *angular = 0.0;
    for (int c = 0; c < s->n; c++) {
        const int e = c * s->l + r, there = sizes[e].most > 0.0;
        Sum *sum = metres(s, c) ? &lengths : radians(s, c) ? NULL : &euler;
        if (sum) {
            sum->squares += sizes[e].first * sizes[e].first;
            sum->count += there;
        }
        *unit = fmax(*unit, sizes[e].most);
        if (radians(s, c) && alike(amplitudes[e]))
            *angular = fmax(*angular, amplitudes[e].first);
    }
    for (int c = 0; c < s->n; c++)
        if (alike(sizes[c * s->l + r]) && (metres(s, c) || !lengths.count))
            *exact = fmax(*exact, sizes[c * s->l + r].most);
    *unit = *exact > 0.0           ? *exact
        : lengths.squares > 0.0    ? sqrt(2.0) * together(lengths)
        : euler.squares > 0.0      ? together(euler)
        : *angular > 0.0           ? *angular
                                   : *unit;
    return *exact > 0.0 || lengths.squares > 0.0 || *angular > 0.0;
}

void default_penalties(Instance *i, const double *q, double *penalties)
{
    const Scene *s = i->scene;
    const size_t used = i->used, n = (size_t)s->n, l = (size_t)s->l;
    double *M = take(i, n * n), *held = take(i, n), *angular = take(i, l);
    double *units = i->units, exact, mean = 0.0, heaviest = 0.0, wide = 0.0;
    Range *sizes = (Range *)take(i, 3 * l * n), *amplitudes = (Range *)take(i, 3 * l * n), all = {0.0, INFINITY, 0.0};
    int known = 1, every_angular = 1, every_exact = 1;
    coefficients(i, q, M, sizes, amplitudes);
    for (int r = 0; r < s->l; r++) {
        known &= unit_of(s, r, sizes, amplitudes, units + r, &exact, angular + r);
        every_angular &= angular[r] > 0.0;
        every_exact &= exact > 0.0;
    }
    for (int r = 0; r < s->l; r++) {
        if (every_angular && !every_exact)
            units[r] = angular[r];
        if (units[r] == 0.0)
            units[r] = 1.0;
        widen(&all, units[r]);
    }
    for (int r = 0; r < s->l; r++) {
        if (alike(all))
            units[r] = all.most;
        mean += log(units[r]) / s->l;
    }
    mean = exp(mean);
    for (int r = 0; !known && all.most <= ALIKE * all.least && r < s->l; r++)
        units[r] = 1 / ALIKE < mean && mean < ALIKE ? 1.0 : mean;
    for (int c = 0; c < s->n; c++) {
        held[c] = 0.0;
        for (int r = 0; r < s->l; r++)
            held[c] = fmax(held[c], sizes[c * s->l + r].most / units[r]);
        wide = fmax(wide, held[c]);
    }
    for (int c = 0; c < s->n; c++)
        if (held[c] > HARDLY * wide) {
            const double size = metres(s, c) ? 1.0 : held[c];
            heaviest = fmax(heaviest, M[c * s->n + c] / (size * size));
        }
    for (int r = 0; r < s->l; r++)
        penalties[r] = PENALTY_RATIO * fmax(heaviest, 1e-300) / (units[r] * units[r]);
    i->used = used;
}

/* Phi and C at q, each row times its weight. */
static void weighted_at(Instance *i, const double *q, const double *weights, double *C, double *phi)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *zeros = take(i, (size_t)s->n);
    memset(zeros, 0, (size_t)s->n * sizeof *zeros);
    constraints_at(i, q, zeros, NULL, C, phi, NULL);
    for (int r = 0; r < s->l; r++) {
        phi[r] *= weights[r];
        for (int c = 0; c < s->n; c++)
            C[c * s->l + r] *= weights[r];
    }
    i->used = used;
}

static int rank_of(Instance *i, const double *C)
{
    const Scene *s = i->scene;
    const int wide = s->l < s->n, few = wide ? s->l : s->n, many = wide ? s->n : s->l;
    const size_t used = i->used;
    double *a = take(i, (size_t)many * (size_t)few), *V = take(i, (size_t)few * (size_t)few);
    double *sizes = take(i, (size_t)few);
    const double least = 1e-7 * fmax(1.0, largest(C, s->l * s->n));
    int rank = 0;
    for (int c = 0; c < s->n; c++)
        for (int r = 0; r < s->l; r++)
            a[wide ? r * s->n + c : c * s->l + r] = C[c * s->l + r];
    singular_values(many, few, a, V, sizes);
    while (rank < few && sizes[rank] > least)
        rank++;
    i->used = used;
    return rank;
}

/* S1: degrees of freedom at regular positions near q. */
static int freedom_near(Instance *i, const double *q, const unsigned char *held)
{
    const Scene *s = i->scene;
    const size_t used = i->used, n = (size_t)s->n, l = (size_t)s->l;
    double *C = take(i, l * n), *phi = take(i, l), *weights = take(i, l), *units = take(i, l), *near = take(i, n);
    double *dq = take(i, n);
    const double size = 0.3 * fmax(1.0, largest(q, s->n)) / sqrt(s->n);
    int rank, found;
    for (int r = 0; r < s->l; r++) {
        weights[r] = held[r];
        units[r] = 0.0;
    }
    for (int k = -1; k < RANKED; k++) { /* Rows in other units are as independent as before. */
        for (int c = 0; c < s->n; c++)
            near[c] = q[c] + (k < 0 ? 0.0 : size * s->normal[k * s->n + c]);
        weighted_at(i, near, weights, C, phi);
        for (int r = 0; r < s->l; r++)
            for (int c = 0; c < s->n; c++)
                units[r] = fmax(units[r], fabs(C[c * s->l + r]));
    }
    for (int r = 0; r < s->l; r++)
        weights[r] = held[r] / (units[r] > 0.0 ? units[r] : 1.0);
    weighted_at(i, q, weights, C, phi);
    rank = rank_of(i, C);
    for (int k = 0; k < RANKED; k++) {
        for (int c = 0; c < s->n; c++)
            near[c] = q[c] + size * s->normal[k * s->n + c];
        for (int pass = 0;; pass++) {
            weighted_at(i, near, weights, C, phi);
            if (pass == 30 || largest(phi, s->l) <= 1e-16 * largest(near, s->n))
                break;
            solved(i, s->l, C, phi, 1e-8, dq);
            for (int c = 0; c < s->n; c++)
                near[c] -= dq[c];
        }
        if (largest(phi, s->l) < 1e-9 && (found = rank_of(i, C)) > rank)
            rank = found;
    }
    i->used = used;
    return s->n - rank;
}

/* S5: combinations (l x l, by columns) of constraints weighted by the root of the penalty, and their sizes at q. */
static void ranges(Instance *i, const double *q, double *combinations, double *sizes)
{
    const Scene *s = i->scene;
    const size_t used = i->used, n = (size_t)s->n, l = (size_t)s->l;
    double *C = take(i, l * n), *turned = take(i, l * n), *zeros = take(i, n);
    memset(zeros, 0, n * sizeof *zeros);
    constraints_at(i, q, zeros, NULL, C, NULL, NULL);
    for (int r = 0; r < s->l; r++)
        for (int c = 0; c < s->n; c++)
            turned[r * s->n + c] = sqrt(i->penalty[r]) * C[c * s->l + r];
    singular_values(s->n, s->l, turned, combinations, sizes);
    i->used = used;
}

/* S5: whether constraints that are redundant at q become independent beside the motion, and so would stop it. */
static int would_brake(Instance *i, const double *q, const double *way)
{
    const Scene *s = i->scene;
    const size_t used = i->used, n = (size_t)s->n, l = (size_t)s->l;
    const int rank = (int)*i->rank;
    double *combinations = take(i, l * l), *sizes = take(i, l), *there = take(i, n), *C = take(i, l * n), found = 0.0;
    int active = 0;
    for (int r = 0; r < s->l; r++)
        active += i->penalty[r] > 0.0;
    if (rank >= active || rank < 1 || s->n > DENSE) {
        i->used = used;
        return 0;
    }
    ranges(i, q, combinations, sizes);
    for (int c = 0; c < s->n; c++)
        there[c] = q[c] + aside[3] * way[c];
    constraints_at(i, there, way, NULL, C, NULL, NULL);
    for (int k = rank; k < s->l; k++)
        for (int c = 0; c < s->n; c++) {
            double sum = 0.0;
            for (int r = 0; r < s->l; r++)
                sum += combinations[k * s->l + r] * sqrt(i->penalty[r]) * C[c * s->l + r];
            found = fmax(found, fabs(sum));
        }
    i->used = used;
    return sizes[rank - 1] >= REGULAR * sizes[0] && found > REGULAR * REGULAR * REGULAR * sizes[0];
}

/* S5: freezes the rank of C at the state before a step. */
void hold(Instance *i)
{
    const Scene *s = i->scene;
    const size_t used = i->used, l = (size_t)s->l;
    const int rank = (int)*i->rank;
    double *combinations, *sizes, *matrix = field(i, s->k) + SETTINGS + 2 * s->l + s->n + s->compliances;
    if (rank < 1 || rank > s->l)
        return;
    combinations = take(i, l * l);
    sizes = take(i, l);
    /* S5: at a singular position the combinations of the place before it are kept. */
    ranges(i, field(i, s->z), combinations, sizes);
    if (sizes[rank - 1] > REGULAR * sizes[0])
        for (int a = 0; a < s->l; a++)
            for (int b = 0; b < s->l; b++) {
                double sum = 0.0;
                for (int k = 0; k < rank; k++)
                    sum += combinations[k * s->l + a] * combinations[k * s->l + b];
                matrix[a * s->l + b] = sqrt(i->penalty[a]) * sum * sqrt(i->penalty[b]) / *i->largest_penalty;
            }
    i->used = used;
}

/* Sorts upwards; there are few. */
static void sort(double *x, int count)
{
    for (int a = 1; a < count; a++)
        for (int b = a; b > 0 && x[b] < x[b - 1]; b--) {
            const double swapped = x[b];
            x[b] = x[b - 1];
            x[b - 1] = swapped;
        }
}

/* S1: scales of coordinates, pivots contributed by masses, degrees of freedom, rank. */
void know(Instance *i, const double *q, const double *v, const unsigned char *held, int usual)
{
    const Scene *s = i->scene;
    const size_t used = i->used, n = (size_t)s->n;
    const double *p = field(i, s->p);
    double *k = field(i, s->k), *inverse_scales = k + SETTINGS + 2 * s->l, margin;
    double *way = take(i, n), *there = take(i, n), *near = take(i, n), *found = take(i, PLACES + 1);
    double *pivots = take(i, n), *diagonal = take(i, n), *columns = take(i, n), *touched = take(i, n);
    double *places = take(i, (PLACES + 1) * n), *rate = take(i, n), *together = take(i, PLACES + 1), size;
    int freedom = s->freedom, count = 1;
    if (!usual || freedom < 0)
        freedom = freedom_near(i, q, held);
    *i->rank = s->n - freedom;
    /* Masses are not known yet. */
    k[5] = 0.0;
    for (int c = 0; c < s->n; c++)
        inverse_scales[c] = 1.0;
    memcpy(way, v, n * sizeof *way);
    memset(touched, 0, n * sizeof *touched);
    memset(i->scales, 0, n * sizeof *i->scales);
    if (largest(v, s->n) == 0.0) {
        const double *x[] = {q, there, v, p, k};
        double *y[] = {way, rate};
        for (int c = 0; c < s->n; c++)
            there[c] = q[c] + s->normal[c];
        call(i, s->bring, x, y);
        for (int c = 0; c < s->n; c++)
            way[c] -= q[c];
    }
    size = fmax(largest(way, s->n), 1e-300);
    for (int c = 0; c < s->n; c++)
        way[c] /= size;
    memcpy(places, q, n * sizeof *q);
    for (int a = 0; a < PLACES; a++) {
        const double *x[] = {there, p, k}, *from[] = {near, p, k}, *beside[] = {near, there, v, p, k};
        double *y[] = {pivots, diagonal, columns, &margin}, *to[] = {near}, *both[] = {near, rate};
        int row;
        for (int c = 0; c < s->n; c++)
            there[c] = q[c] + aside[a] * way[c];
        call(i, s->pivots, x, y);
        for (int c = 0; c < s->n; c++) {
            touched[c] += columns[c];
            i->scales[c] = fmax(i->scales[c], *i->largest_penalty * diagonal[c]);
        }
        call(i, s->place, x, to);
        call(i, s->place, from, to);
        call(i, s->bring, beside, both);
        call(i, s->place, from, to);
        if (widest(i, near, v, 0, &row) <= GROSS)
            memcpy(places + count++ * n, near, n * sizeof *near);
    }
    *i->freedom = freedom;
    for (int c = 0; c < s->n; c++) {
        *i->freedom -= touched[c] == 0.0;
        inverse_scales[c] = *i->largest_penalty / i->scales[c];
    }
    i->flags.brakes = 0;
    for (int a = 0; a < count; a++) {
        const double *x[] = {places + a * n, p, k};
        double *y[] = {pivots, diagonal, columns, &margin};
        int bad = 0;
        i->flags.brakes |= would_brake(i, places + a * n, way);
        call(i, s->pivots, x, y);
        for (int c = 0; c < s->n; c++)
            bad |= !(pivots[c] > 0.0);
        sort(pivots, bad ? 0 : s->n);
        found[a] = together[a] = 0.0;
        for (int c = 0; c < s->n; c++) {
            const double part = log(bad ? 1e-300 : fmax(pivots[c], 1e-300));
            found[a] += c < *i->freedom ? part : 0.0;
            together[a] += part;
        }
    }
    /* Where a coordinate cannot tell the motion its pivot is far larger; at a singular position it may be smaller. */
    sort(together, count);
    *i->regular = (together[(count - 1) / 2] + together[count / 2]) / 2 + log(REGULAR_PRODUCT);
    sort(found, count);
    while (count > 1 && !(found[count - 1] <= found[1] + FAR_RATIO))
        count--;
    *i->masses = floor((found[(count - 1) / 2] + found[count / 2]) / 2 * COARSE + 0.5) / COARSE;
    for (int c = 0; c < s->n; c++)
        i->scales[c] = (float)i->scales[c];
    i->used = used;
}

Outcome instance_mobility(Instance *i, int *freedom, int *redundant, int *here)
{
    const Scene *s = i->scene;
    unsigned char *held;
    double *C, *phi, *weights;
    i->used = 0;
    *freedom = *here = s->n;
    *redundant = 0;
    if (!i->flags.initialized)
        return say(i, REFUSED, "%s: its degrees of freedom are known after initialising", s->name);
    if (!s->l)
        return DONE;
    held = (unsigned char *)take(i, (size_t)s->l);
    C = take(i, (size_t)s->l * (size_t)s->n);
    phi = take(i, (size_t)s->l);
    weights = take(i, (size_t)s->l);
    for (int r = 0; r < s->l; r++) {
        held[r] = i->penalty[r] > 0.0;
        weights[r] = held[r] / i->units[r];
        *redundant += held[r];
    }
    *freedom = freedom_near(i, field(i, s->z), held);
    *redundant -= s->n - *freedom;
    weighted_at(i, field(i, s->z), weights, C, phi);
    *here = s->n - rank_of(i, C);
    i->used = 0;
    return DONE;
}
