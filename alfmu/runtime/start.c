/* The start of a run: loops closed from a guess, velocities made consistent, massless bodies checked, penalties scaled,
   what tells a singular position found out. */

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "start.h"
#include "tape.h"
#include "text.h"

/* What an assembly closes: the gaps of the rows that are held, and the start values. */
typedef struct {
    const unsigned char *held;
    int count; /* of both */
    int untied; /* whether start values are guesses, too */
    Rows J;
    double *residue, *trial;
} Loops;

static const double *starts(const Instance *i)
{
    return i->values + i->scene->own;
}

static int metres(const Scene *s, int coordinate)
{
    return !strcmp(s->coordinates[coordinate].unit, "m");
}

static int radians(const Scene *s, int coordinate)
{
    return !strcmp(s->coordinates[coordinate].unit, "rad");
}

Matrix matrix_new(Instance *i, const Pattern *pattern)
{
    return (Matrix){pattern, take(i, (size_t)pattern->entries)};
}

/* The largest of coordinates, or of a displacement or a rate of them, lengths over that of the mechanism. */
double largest_of(const Instance *i, const double *x)
{
    const Scene *s = i->scene;
    double found = 0.0;
    for (int c = 0; c < s->n; c++)
        found = fmax(found, fabs(x[c]) / (metres(s, c) ? *i->length : 1.0));
    return found;
}

/* y = A x */
static void times(Matrix a, const double *x, double *y)
{
    const Pattern *p = a.pattern;
    memset(y, 0, (size_t)p->rows * sizeof *y);
    for (int c = 0; c < p->columns; c++)
        for (int e = p->offsets[c]; e < p->offsets[c + 1]; e++)
            y[p->indices[e]] += a.values[e] * x[c];
}

/* Each row times its weight. */
static void weigh_rows(Matrix a, const double *weights)
{
    for (int e = 0; e < a.pattern->entries; e++)
        a.values[e] *= weights[a.pattern->indices[e]];
}

void all_times(const Rows *J, const double *x, double *y)
{
    times(J->constraints, x, y);
    times(J->ties, x, y + J->constraints.pattern->rows);
}

void all_times_back(const Rows *J, const double *y, double *x)
{
    const Matrix parts[] = {J->constraints, J->ties};
    memset(x, 0, (size_t)parts->pattern->columns * sizeof *x);
    for (int k = 0; k < 2; y += parts[k++].pattern->rows)
        for (int c = 0; c < parts[k].pattern->columns; c++)
            for (int e = parts[k].pattern->offsets[c]; e < parts[k].pattern->offsets[c + 1]; e++)
                x[c] += parts[k].values[e] * y[parts[k].pattern->indices[e]];
}

/* J J', with LOOSE of its largest entry on the diagonal, which makes it regular; returns that entry. */
static double squared(Instance *i, const Rows *J, double *a)
{
    const Envelope *e = &i->scene->closing;
    const Pattern *above = J->constraints.pattern, *below = J->ties.pattern;
    const size_t used = i->used;
    double *values = take(i, (size_t)e->size), *rows = take(i, (size_t)e->size), most = 0.0;
    memset(a, 0, e->entries * sizeof *a);
    for (int c = 0; c < above->columns; c++) {
        int count = 0;
        for (int k = above->offsets[c]; k < above->offsets[c + 1]; k++, count++) {
            values[count] = J->constraints.values[k];
            rows[count] = above->indices[k];
        }
        for (int k = below->offsets[c]; k < below->offsets[c + 1]; k++, count++) {
            values[count] = J->ties.values[k];
            rows[count] = above->rows + below->indices[k];
        }
        for (int k = 0; k < count; k++)
            for (int j = 0; j <= k; j++)
                *envelope_entry(e, a, (int)rows[k], (int)rows[j]) += values[k] * values[j];
    }
    for (int r = 0; r < e->size; r++)
        most = fmax(most, *envelope_entry(e, a, r, r));
    most = most > 0.0 ? most : 1.0;
    for (int r = 0; r < e->size; r++)
        *envelope_entry(e, a, r, r) += LOOSE * most;
    i->used = used;
    return most;
}

/* x (n) of least norm with J x = r as nearly as possible: the correction (10) with the unit matrix in place of M, repeated
   until it gains no more, at most so often. x = J' lam, and lam = (J J' + 1 / alpha)^-1 (r - J x) adds up, so that rows
   that depend on each other share it; a direction that rows hold less than some 1e-6 of what they hold others needs more
   passes than there are. */
void least_multipliers(Instance *i, const Rows *J, const double *r, int most, double *lam, double *x)
{
    const Envelope *e = &i->scene->closing;
    const size_t used = i->used, rows = (size_t)e->size;
    double *a = take(i, e->entries), *left = take(i, rows), *change = take(i, rows);
    double *work = take(i, rows), size = norm(r, e->size), before = INFINITY;
    squared(i, J, a);
    envelope_factor(e, a, DBL_MIN);
    memset(lam, 0, rows * sizeof *lam);
    memset(x, 0, (size_t)i->scene->n * sizeof *x);
    memcpy(left, r, rows * sizeof *left);
    for (int pass = 0; pass < most && size > 0.0 && size < GAINED * before; pass++) {
        envelope_solve(e, a, left, change, work);
        for (int k = 0; k < e->size; k++)
            lam[k] += change[k];
        all_times_back(J, lam, x);
        all_times(J, x, left);
        for (int k = 0; k < e->size; k++)
            left[k] = r[k] - left[k];
        before = size;
        size = norm(left, e->size);
    }
    i->used = used;
}

static void least_correction(Instance *i, const Rows *J, const double *r, int most, double *x)
{
    const size_t used = i->used;
    least_multipliers(i, J, r, most, take(i, (size_t)i->scene->closing.size), x);
    i->used = used;
}

/* Residue and matrix at q. */
static void closure_at(Instance *i, Loops *loops, const double *q)
{
    const Scene *s = i->scene;
    const double *x[] = {q, field(i, s->p), starts(i)};
    double *y[] = {loops->J.constraints.values, loops->J.ties.values, loops->residue, loops->residue + s->l};
    call(i, s->closure, x, y);
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

static Loops loops_new(Instance *i, const unsigned char *held)
{
    const Scene *s = i->scene;
    Loops loops = {held, s->l + s->ties, 0, {matrix_new(i, &s->gaps), matrix_new(i, &s->tie_rows)}, NULL, NULL};
    loops.residue = take(i, (size_t)loops.count);
    loops.trial = take(i, (size_t)s->n);
    return loops;
}

/* Whether what is left is so small a share of the coordinates, gaps in metres over the length of the mechanism. */
static int within(const Instance *i, const Loops *loops, const double *q, double share)
{
    const Scene *s = i->scene;
    double found = 0.0;
    for (int k = 0; k < loops->count; k++)
        found = fmax(found, fabs(loops->residue[k]) / (k < s->l && !strcmp(s->rows[k].unit, "m") ? *i->length : 1.0));
    return found <= share * fmax(1.0, largest_of(i, q));
}

static int closes(Instance *i, Loops *loops, const double *q)
{
    closure_at(i, loops, q);
    return within(i, loops, q, ROUGH);
}

/* Gauss-Newton steps of least norm from q to where they end; the length of the first one. */
static double followed(Instance *i, Loops *loops, double *q)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *dq = take(i, (size_t)s->n), *lam = take(i, (size_t)loops->count), first = -1.0;
    closure_at(i, loops, q);
    for (int k = 0; k < MOST; k++) {
        double size = norm(loops->residue, loops->count), turned = 1e-300, part;
        if (within(i, loops, q, TOLERANCE))
            break;
        least_multipliers(i, &loops->J, loops->residue, CORRECTIONS, lam, dq);
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
        tape_closing(i, loops->held, q, dq, lam, part);
        memcpy(q, loops->trial, (size_t)s->n * sizeof *q);
    }
    i->used = used;
    return fmax(first, 0.0);
}

/* A change of a coordinate, of an angle by at most half a turn. */
static double short_way(const Scene *s, int coordinate, double change)
{
    return strcmp(s->coordinates[coordinate].unit, "rad") ? change : remainder(change, 4 * QUARTER);
}

/* The length of the shortest way from one place to another. */
static double apart(const Scene *s, const double *from, const double *to)
{
    double square = 0.0;
    for (int c = 0; c < s->n; c++)
        square += pow(short_way(s, c, to[c] - from[c]), 2);
    return sqrt(square);
}

/* An assembly beside the one that the start ends in, and how far it is from the guess. */
typedef struct {
    const double *own;
    double *q, way;
} Another;

/* A place beside the guess from which an assembly is looked for, the k-th of them. */
static void beside(const Scene *s, const double *guess, double size, int k, double *q)
{
    for (int c = 0; c < s->n; c++)
        q[c] = guess[c] + size * (0.2 + 1.3 * k / (TRIES - 1)) * s->normal[k * s->n + c] / sqrt(s->n);
}

/* The assembly nearest to the guess among those found from places around it, and the number of its place; -1 where there
   is none. The nearest one that is not the own is `another`. */
static int nearest(Instance *i, Loops *loops, const double *guess, double size, double *found, Another *another)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *q = take(i, (size_t)s->n), best = INFINITY;
    int from = -1;
    const int paused = tape_pause(i, 1);
    another->way = INFINITY;
    for (int k = 0; k < TRIES; k++) {
        double away = 0.0;
        beside(s, guess, size, k, q);
        followed(i, loops, q);
        if (!closes(i, loops, q))
            continue;
        for (int c = 0; c < s->n; c++)
            away += (q[c] - guess[c]) * (q[c] - guess[c]);
        if (away < best) {
            best = away;
            from = k;
            memcpy(found, q, (size_t)s->n * sizeof *q);
        }
        away = apart(s, guess, q);
        if (away < another->way && apart(s, another->own, q) > DISTINCT) {
            another->way = away;
            for (int c = 0; c < s->n; c++) /* Angles that a reader compares with the guess, without whole turns. */
                another->q[c] = guess[c] + short_way(s, c, q[c] - guess[c]);
        }
    }
    tape_pause(i, paused);
    i->used = used;
    return from;
}

/* Whether an assembly leads back to itself from a place beside it: start values determine it. */
static int determined(Instance *i, Loops *loops, const double *assembly)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *q = take(i, (size_t)s->n);
    const int paused = tape_pause(i, 1);
    int back;
    for (int c = 0; c < s->n; c++)
        q[c] = assembly[c] + DISTINCT * s->normal[c] / sqrt(s->n);
    followed(i, loops, q);
    tape_pause(i, paused);
    back = closes(i, loops, q) && apart(s, assembly, q) < DISTINCT * DISTINCT;
    i->used = used;
    return back;
}

const char *in_unit(const char *unit, double value, char *text)
{
    if (!strcmp(unit, "rad"))
        write_text(text, QUANTITY, "%.6g rad (%.4g deg)", value, value * 90 / QUARTER);
    else
        write_text(text, QUANTITY, strcmp(unit, "1") ? "%.6g %s" : "%.6g", value, unit);
    return text;
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
        write_text(label, size, "a gap of %.3g %s at %s", sqrt(gap), s->rows[worst].unit, s->rows[worst].name);
    } else {
        const Variable *start = s->variables + s->own + s->tied[worst - s->l];
        char left[QUANTITY];
        snprintf(label, size, "%s missed by %s", start->name, in_unit(start->unit, fabs(loops->residue[worst]), left));
    }
    return label;
}

/* The length of the way from one place to another, and the coordinate that changes most on it. */
static double way(const Scene *s, const double *from, const double *to, int *most)
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

/* The length that has most changed its sign from one place to another, by more than AWAY; -1 where none has. Angles of a
   rough guess do so in assemblies that look alike. */
static int crossed(const Scene *s, const double *from, const double *to)
{
    int most = -1;
    double longest = AWAY;
    for (int c = 0; c < s->n; c++)
        if (!strcmp(s->coordinates[c].unit, "m") && from[c] * to[c] < 0.0 && fabs(to[c] - from[c]) > longest) {
            longest = fabs(to[c] - from[c]);
            most = c;
        }
    return most;
}

/* DONE, with a warning where the guess is about as near to another assembly, or the only one is on its other side. */
static Outcome alone(Instance *i, Loops *loops, const double *guess, const double *q, const Another *another)
{
    const Scene *s = i->scene;
    char own[QUANTITY], given[QUANTITY], other[QUANTITY];
    int most, c = crossed(s, guess, q);
    if (another->way < BETWEEN * apart(s, guess, q) && determined(i, loops, q)) {
        way(s, q, another->q, &most);
        say(i, DONE,
            "%s: the guess lies between two assemblies; in the one taken %s is %s, guessed as %s, and in the other, hardly "
            "farther from the guess, it is %s; give start values or guesses closer to the assembly you want",
            s->name, s->coordinates[most].name, in_unit(s->coordinates[most].unit, q[most], own),
            in_unit(s->coordinates[most].unit, guess[most], given),
            in_unit(s->coordinates[most].unit, another->q[most], other));
    } else if (c >= 0)
        say(i, DONE,
            "%s: the loops closed where %s is %s, guessed as %s on the other side of zero, and no nearer assembly was found; "
            "check lengths and offsets, or give start values or guesses closer to this assembly",
            s->name, s->coordinates[c].name, in_unit(s->coordinates[c].unit, q[c], own),
            in_unit(s->coordinates[c].unit, guess[c], given));
    return DONE;
}

/* The refusal of loops that do not close, with the start values where they do, if anywhere. */
static Outcome not_closed(Instance *i, Loops *loops, const double *guess, double *q)
{
    const Scene *s = i->scene;
    const size_t used = i->used, n = (size_t)s->n;
    double *other = take(i, n), most = 0.0;
    Another another = {q, take(i, n), INFINITY};
    char label[200], hint[400] = "", own[QUANTITY], given[QUANTITY];
    int worst = -1, contradict;
    closure_at(i, loops, q);
    contradict = largest(loops->residue, s->l) <= ROUGH;
    gap_label(i, loops, label, sizeof label);
    if (s->ties && !contradict) { /* Start values that give way, too. */
        memcpy(other, guess, n * sizeof *other);
        loops->untied = 1;
        followed(i, loops, other);
        if (closes(i, loops, other) || nearest(i, loops, guess, 3.0, other, &another) >= 0) {
            loops->untied = 0;
            closure_at(i, loops, other);
            for (int k = 0; k < s->ties; k++)
                if (fabs(loops->residue[s->l + k]) > most) {
                    most = fabs(loops->residue[s->l + k]);
                    worst = k;
                }
        }
        loops->untied = 0;
    }
    if (worst >= 0) {
        const Variable *start = s->variables + s->own + s->tied[worst];
        const double value = starts(i)[s->tied[worst]];
        snprintf(hint, sizeof hint, "; they close where %s is %s instead of %s", start->name,
            in_unit(start->unit, value + loops->residue[s->l + worst], own), in_unit(start->unit, value, given));
    }
    i->used = used;
    return say(i, FAILED, "%s: %s; the nearest assembly leaves %s; %s%s", s->name,
        contradict ? "the start values contradict each other" : "the loops cannot be closed", label,
        s->ties > 1 ? "give fewer or consistent start values" : "check lengths, offsets and start values", hint);
}

/* How far an assembly has an angle or a length from its guess, over what is told; a guess of zero may be none. */
static double missed(const Instance *i, int c, const double *guess, const double *q)
{
    const Scene *s = i->scene;
    const double told = radians(s, c) ? MISSED : metres(s, c) ? MISSED_LENGTHS * *i->length : INFINITY;
    return guess[c] != 0.0 ? fabs(short_way(s, c, q[c] - guess[c])) / told : 0.0;
}

/* Whether the loops close elsewhere, near the guess whose angles that are missed or beyond a turn are read as degrees: `meant`
   is that guess, and `there` the assembly beside it. */
static int fits_in_degrees(Instance *i, Loops *loops, const double *guess, const double *q, double *meant, double *there)
{
    const Scene *s = i->scene;
    const int paused = tape_pause(i, 1);
    int fits = 0;
    for (int c = 0; c < s->n; c++) {
        const int beyond = radians(s, c) && fabs(guess[c]) > 4 * QUARTER, off = missed(i, c, guess, q) > 1.0;
        fits |= (radians(s, c) && off) || (beyond && fabs(q[c] - guess[c]) > DISTINCT);
        meant[c] = there[c] = guess[c] * (beyond || (radians(s, c) && off) ? QUARTER / 90 : 1.0);
    }
    if (fits)
        followed(i, loops, there);
    fits = fits && closes(i, loops, there) && apart(s, there, q) > DISTINCT;
    for (int c = 0; c < s->n; c++)
        fits &= meant[c] == guess[c] || fabs(short_way(s, c, there[c] - meant[c])) < AWAY;
    tape_pause(i, paused);
    return fits;
}

/* Adds a warning, unless there is one, of guesses far from which the loops closed; in its place one of angles in degrees. */
static void check_guesses(Instance *i, Loops *loops, const double *guess, const double *q)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *meant = take(i, (size_t)s->n), *there = take(i, (size_t)s->n);
    char list[sizeof i->text / 2] = "", own[QUANTITY], given[QUANTITY], other[QUANTITY];
    const int degrees = fits_in_degrees(i, loops, guess, q, meant, there);
    int found = 0;
    for (int c = 0; c < s->n && (degrees || !*i->text); c++) {
        const char *name = s->coordinates[c].name, *unit = s->coordinates[c].unit;
        const double turns = fabs(guess[c]) > 4 * QUARTER && radians(s, c) ? q[c] - short_way(s, c, q[c]) : 0.0;
        char *end = list + strlen(list);
        if (degrees ? meant[c] == guess[c] : missed(i, c, guess, q) <= 1.0)
            continue;
        in_unit(unit, q[c] - turns, own);
        in_unit(unit, guess[c], given);
        if (++found > SAID / 2)
            continue;
        if (degrees)
            snprintf(end, sizeof list - strlen(list), "%s%.40s is %s, guessed as %s, and would be %s", found > 1 ? "; " : "", name,
                own, given, in_unit(unit, there[c], other));
        else
            snprintf(
                end, sizeof list - strlen(list), "%s%.40s is %s, guessed as %s", found > 1 ? "; " : "", name, own, given);
    }
    if (found > SAID / 2)
        snprintf(list + strlen(list), sizeof list - strlen(list), "; and %d more", found - SAID / 2);
    if (degrees)
        say(i, DONE,
            "%s: the loops closed far from guesses that fit another assembly if they are read as degrees: %s; give guesses in "
            "rad",
            s->name, list);
    else if (found)
        say(i, DONE, "%s: the loops closed far from what was given: %s; give guesses closer to the assembly you want", s->name,
            list);
    i->used = used;
}

/* How far (limits) displacements are beyond their limits at q; `J` (limits x n, by columns) may be NULL. */
static void beyond_limits(Instance *i, const double *q, double *beyond, double *J)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    const double *x[] = {q, field(i, s->p)};
    double *y[] = {beyond, J ? J : take(i, (size_t)s->limit_count * (size_t)s->n)};
    call(i, s->stops, x, y);
    i->used = used;
}

/* The limit that q is beyond most, by how much more than is allowed there, lengths over that of the mechanism. */
static double most_beyond(Instance *i, const double *q, const double *allowed, int *worst)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *beyond = take(i, (size_t)s->limit_count), most = -INFINITY;
    beyond_limits(i, q, beyond, NULL);
    for (int k = 0; k < s->limit_count; k++) {
        const double left = (beyond[k] - allowed[k]) / (strcmp(s->limited[k].unit, "m") ? 1.0 : *i->length);
        if (left > most) {
            most = left;
            *worst = k;
        }
    }
    i->used = used;
    return most;
}

/* Whether closing the loops and going back from limits, one after the other, leads from q to an assembly within limits. */
static int brought_within(Instance *i, Loops *loops, const double *allowed, double *q)
{
    const Scene *s = i->scene;
    const size_t used = i->used, n = (size_t)s->n, count = (size_t)s->limit_count;
    double *beyond = take(i, count), *J = take(i, count * n), *way = take(i, n), size = INFINITY, square, part;
    int worst;
    for (int pass = 0; pass < MOST && size > 0.0; pass++) {
        followed(i, loops, q);
        size = closes(i, loops, q) ? most_beyond(i, q, allowed, &worst) : NAN;
        if (!(size > 0.0))
            break;
        beyond_limits(i, q, beyond, J);
        memset(way, 0, n * sizeof *way);
        size = square = part = 0.0;
        for (int k = 0; k < s->limit_count; k++) { /* A little within them, so that few passes are made. */
            const double unit = strcmp(s->limited[k].unit, "m") ? 1.0 : *i->length;
            const double left = beyond[k] > allowed[k] ? (beyond[k] - allowed[k]) / unit + DISTINCT / 10 : 0.0;
            size += left * left;
            for (int c = 0; c < s->n; c++)
                way[c] += left * J[(size_t)c * count + (size_t)k] * (metres(s, c) ? *i->length : 1.0) / unit;
        }
        for (int c = 0; c < s->n; c++) {
            square += way[c] * way[c];
            part = fmax(part, fabs(way[c]));
        }
        if (square < 1e-300)
            break;
        part = fmin(size / square, LONGEST_TURN / part);
        for (int c = 0; c < dependent(s); c++)
            q[c] -= part * way[c] * (metres(s, c) ? *i->length : 1.0);
    }
    i->used = used;
    return size <= 0.0;
}

/* Looks for an assembly within the limits of stops where the one at q is far beyond one, and takes the nearest found. What the
   guess itself is beyond a limit is allowed. */
static void keep_limits(Instance *i, Loops *loops, const double *guess, double *q, Mark begin)
{
    const Scene *s = i->scene;
    const size_t used = i->used, n = (size_t)s->n;
    double *allowed, *tried, *found, nearest_way = INFINITY, left;
    char how[QUANTITY], own[QUANTITY], given[QUANTITY];
    int worst, most;
    if (!s->limit_count || s->n > DENSE)
        return;
    allowed = take(i, (size_t)s->limit_count);
    tried = take(i, n);
    found = take(i, n);
    beyond_limits(i, guess, allowed, NULL);
    for (int k = 0; k < s->limit_count; k++)
        allowed[k] = fmax(allowed[k], 0.0);
    left = most_beyond(i, q, allowed, &worst);
    if (left > DISTINCT) { /* Less is a load on the stop. */
        const int paused = tape_pause(i, 1);
        for (int k = -1; k < TRIES; k++) {
            memcpy(tried, q, n * sizeof *tried);
            if (k >= 0)
                beside(s, guess, 3.0, k, tried);
            if (brought_within(i, loops, allowed, tried) && apart(s, guess, tried) < nearest_way) {
                nearest_way = apart(s, guess, tried);
                memcpy(found, tried, n * sizeof *found);
            }
        }
        tape_pause(i, paused);
        in_unit(s->limited[worst].unit, left * (strcmp(s->limited[worst].unit, "m") ? 1.0 : *i->length), how);
        if (nearest_way < INFINITY) {
            tape_cut(i, begin);
            memcpy(q, found, n * sizeof *q);
            tape_copy(i, q, guess, n);
            way(s, guess, q, &most);
            say(i, DONE,
                "%s: the assembly nearest to the guess is beyond %s by %s; the nearest found within limits is taken, where %s is "
                "%s, guessed as %s; give start values or guesses closer to the assembly you want",
                s->name, s->limited[worst].name, how, s->coordinates[most].name, in_unit(s->coordinates[most].unit, q[most], own),
                in_unit(s->coordinates[most].unit, guess[most], given));
        } else
            say(i, DONE,
                "%s: no assembly within limits was found; the one taken is beyond %s by %s; check the limits, lengths and start "
                "values",
                s->name, s->limited[worst].name, how);
    }
    i->used = used;
}

static Outcome positions(Instance *i, Loops *loops, const double *guess, double *q)
{
    const Scene *s = i->scene;
    const Mark begin = tape_mark(i);
    double step, moved, size, away = INFINITY, *other = take(i, (size_t)s->n);
    Another another = {q, take(i, (size_t)s->n), INFINITY};
    char own[QUANTITY], given[QUANTITY], theirs[QUANTITY];
    int most, from, direct;
    i->text[0] = '\0';
    memcpy(q, guess, (size_t)s->n * sizeof *q);
    tape_copy(i, q, guess, (size_t)s->n);
    step = followed(i, loops, q);
    moved = closes(i, loops, q) ? way(s, guess, q, &most) : INFINITY;
    direct = moved <= 1.5 * step + 1e-6;
    if (direct && (moved <= AWAY || s->n > DENSE))
        return DONE;
    /* A long way, or none: is there an assembly nearer to the guess? */
    size = fmin(moved, 3.0);
    from = nearest(i, loops, guess, size, other, &another);
    if (from >= 0)
        away = way(s, guess, other, &most);
    if (direct) {
        if (away < NEARER * moved) {
            way(s, q, other, &most);
            say(i, DONE,
                "%s: the loops closed far from the guess, where %s is %s, guessed as %s, and in a nearer assembly it is %s; "
                "give start values or guesses closer to the assembly you want",
                s->name, s->coordinates[most].name, in_unit(s->coordinates[most].unit, q[most], own),
                in_unit(s->coordinates[most].unit, guess[most], given),
                in_unit(s->coordinates[most].unit, other[most], theirs));
        }
        return away < NEARER * moved ? DONE : alone(i, loops, guess, q, &another);
    }
    if (from < 0 && moved == INFINITY)
        return not_closed(i, loops, guess, q);
    if (from >= 0 && away < 0.99 * moved) { /* From the guess the way leads elsewhere, or nowhere. */
        tape_cut(i, begin);
        beside(s, guess, size, from, q);
        tape_copy(i, q, guess, (size_t)s->n);
        followed(i, loops, q);
        way(s, guess, q, &most);
        return say(i, DONE,
            "%s: no short way leads from the guess to closed loops; in the nearest assembly found, which is taken, %s is %s, "
            "guessed as %s; give start values or guesses closer to the assembly you want",
            s->name, s->coordinates[most].name, in_unit(s->coordinates[most].unit, q[most], own),
            in_unit(s->coordinates[most].unit, guess[most], given));
    }
    return alone(i, loops, guess, q, &another);
}

/* Velocities that keep the loops closed and have the rates of start values, nearest to the guess v; what they leave. */
static void rated(Instance *i, Loops *loops, const double *q, const double *rate, double *v, double *left)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *made = take(i, (size_t)loops->count), *dv = take(i, (size_t)s->n), *weights = take(i, (size_t)s->l);
    double *lam = take(i, (size_t)loops->count);
    const Rows J = {matrix_new(i, &s->constraint), loops->J.ties};
    closure_at(i, loops, q);
    constraints_at(i, q, v, NULL, J.constraints.values, NULL, NULL);
    for (int r = 0; r < s->l; r++)
        weights[r] = loops->held[r];
    weigh_rows(J.constraints, weights);
    for (int pass = 0; pass < 3; pass++) {
        all_times(&J, v, made);
        if (s->timed) { /* Also what constraints move by themselves. */
            constraints_at(i, q, v, NULL, NULL, NULL, made);
            for (int r = 0; r < s->l; r++)
                made[r] *= weights[r];
        }
        for (int r = 0; r < loops->count; r++)
            left[r] = (r < s->l ? 0.0 : rate[s->tied[r - s->l]]) - made[r];
        if (pass == 2)
            break;
        least_multipliers(i, &J, left, CORRECTIONS, lam, dv);
        tape_rating(i, loops->held, q, v, dv, lam);
        for (int c = 0; c < s->n; c++)
            v[c] += dv[c];
    }
    i->used = used;
}

/* Velocities that keep the loops closed and have the start rates, nearest to the guess v. */
static Outcome rates(Instance *i, Loops *loops, const double *q, double *v)
{
    const Scene *s = i->scene;
    const size_t n = (size_t)s->n, l = (size_t)s->l, count = (size_t)loops->count;
    const double *rate = starts(i) + s->starts;
    double *left = take(i, count), *made = take(i, count), *dv = take(i, n), *weights = take(i, l);
    double *F = take(i, n), *zeros = take(i, (size_t)driven_by(s) + 1), *M = take(i, (size_t)s->mass.entries);
    double lost = 0.0, most;
    const double zero = 0.0;
    Rows J = {matrix_new(i, &s->constraint), loops->J.ties};
    int worst = 0;
    rated(i, loops, q, rate, v, left);
    for (int r = 0; r < s->l; r++)
        weights[r] = loops->held[r];
    for (int r = 1; r < loops->count; r++)
        if (fabs(left[r]) > fabs(left[worst]))
            worst = r;
    if (!(largest(left, loops->count) <= ROUGH * fmax(1.0, largest_of(i, v))))
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
        double *y[] = {M, J.constraints.values, F, left};
        memset(zeros, 0, ((size_t)driven_by(s) + 1) * sizeof *zeros);
        call(i, s->dynamics, x, y);
    }
    for (int r = 0; r < s->l; r++)
        weights[r] = loops->held[r] / (!strcmp(s->rows[r].unit, "m") ? *i->length : 1.0);
    weigh_rows(J.constraints, weights);
    for (int c = 0; c < s->n; c++)
        for (int e = s->constraint.offsets[c]; metres(s, c) && e < s->constraint.offsets[c + 1]; e++)
            J.constraints.values[e] *= *i->length;
    memset(J.ties.values, 0, (size_t)s->tie_rows.entries * sizeof *J.ties.values);
    memset(left + l, 0, (size_t)s->ties * sizeof *left);
    for (int r = 0; r < s->l; r++)
        left[r] *= weights[r];
    /* A motion keeps what C hardly holds within that times its acceleration: two passes leave it. */
    least_correction(i, &J, left, 2, dv);
    times(J.constraints, dv, made);
    most = largest(left, s->l);
    for (int r = 0; r < s->l; r++)
        if (fabs(left[r] - made[r]) > lost) {
            lost = fabs(left[r] - made[r]);
            worst = r;
        }
    if (lost > 1e-3 * fmax(1.0, most))
        return say(i, FAILED,
            "%s: the start is a singular position, and its rates belong to none of the motions possible there (%s "
            "would open by %.3g %s/s2); start a little beside it",
            s->name, s->rows[worst].name, lost / weights[worst], s->rows[worst].unit);
    return DONE;
}

/* The direction of a motion that starts at rest, as a velocity that is nothing: that of equal rates of the start values;
   it stays at rest where there is no such motion. */
void set_off(Instance *i, const unsigned char *held, const double *q, double *v)
{
    const Scene *s = i->scene;
    const size_t used = i->used, n = (size_t)s->n;
    const int paused = tape_pause(i, 1);
    double *guess = take(i, n), *way = take(i, n), *equal = take(i, (size_t)s->starts), size;
    const double *x[] = {field(i, s->p), starts(i), equal};
    double *y[] = {guess, way};
    Loops loops = loops_new(i, held);
    for (int k = 0; k < s->starts; k++)
        equal[k] = 1.0;
    call(i, s->guesses, x, y);
    if (s->timed)
        way[s->n - 1] = 0.0;
    rated(i, &loops, q, equal, way, loops.residue);
    size = largest(way, s->n);
    if (size > 0.0 && largest(loops.residue, loops.count) <= ROUGH * size)
        for (int c = 0; c < dependent(s); c++)
            v[c] = DIRECTION / size * way[c];
    tape_pause(i, paused);
    i->used = used;
}

/* A joint, or a start value, that the guess gives no finite gap; NULL where each has one. */
static const char *without_gap(Instance *i, Loops *loops, const double *guess)
{
    const Scene *s = i->scene;
    closure_at(i, loops, guess);
    for (int k = 0; k < loops->count; k++)
        if (!isfinite(loops->residue[k]))
            return k < s->l ? s->rows[k].name : s->variables[s->own + s->tied[k - s->l]].name;
    return NULL;
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

/* Nonzeros of C at several places: as they are, and of angles also with a quarter turn of their own. Those that are
   round-off everywhere count as zero: a constraint of nothing else would hold by a penalty of its own what it does not. */
static void coefficients(Instance *i, const double *q, double *M, Range *sizes, Range *amplitudes)
{
    const Scene *s = i->scene;
    const size_t used = i->used, n = (size_t)s->n, entries = (size_t)s->constraint.entries;
    const int *offsets = s->constraint.offsets;
    double *C = take(i, entries), *turned = take(i, entries), *own = take(i, entries);
    double *there = take(i, n), *zeros = take(i, n), most = 1.0;
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
            memcpy(own + offsets[c], turned + offsets[c], (size_t)(offsets[c + 1] - offsets[c]) * sizeof *own);
            there[c] = kept;
        }
        for (size_t e = 0; e < entries; e++) {
            widen(sizes + e, fabs(C[e]));
            widen(amplitudes + e, hypot(C[e], own[e]));
            most = fmax(most, fabs(C[e]));
        }
    }
    for (size_t e = 0; e < entries; e++)
        if (amplitudes[e].most <= SAME * most)
            sizes[e] = amplitudes[e] = (Range){0.0, 0.0, 0.0};
    i->used = used;
}

/* What some coefficients of a row come to together. */
typedef struct {
    double squares, count;
} Sum;

static double together(Sum sum)
{
    return sqrt(sum.squares / fmax(sum.count, 1.0));
}

/* What the coefficients of a row tell of its unit. */
typedef struct {
    Sum lengths, euler;
    double most, constant, constant_length, angular;
} Told;

static void tell(const Scene *s, const Range *sizes, const Range *amplitudes, Told *told)
{
    const Pattern *p = &s->constraint;
    for (int c = 0; c < s->n; c++)
        for (int e = p->offsets[c]; e < p->offsets[c + 1]; e++) {
            Told *row = told + p->indices[e];
            Sum *sum = metres(s, c) ? &row->lengths : radians(s, c) ? NULL : &row->euler;
            if (sum) {
                sum->squares += sizes[e].first * sizes[e].first;
                sum->count += sizes[e].most > 0.0;
            }
            row->most = fmax(row->most, sizes[e].most);
            if (radians(s, c) && alike(amplitudes[e]))
                row->angular = fmax(row->angular, amplitudes[e].first);
            if (alike(sizes[e]))
                row->constant = fmax(row->constant, sizes[e].most);
            if (alike(sizes[e]) && metres(s, c))
                row->constant_length = fmax(row->constant_length, sizes[e].most);
        }
}

/* What displacements and their rates are measured in: the longest arm by which an angle moves a point, of constraints of
   lengths alone the least radius by which their coefficients turn; 1 m where that is of its size, or nothing tells it.
   Rows in other units have the same arms: those of a known coefficient of a length are over it, and others count where
   none is. */
static double own_length(Instance *i, const double *q)
{
    const Scene *s = i->scene;
    const Pattern *p = &s->constraint;
    const size_t used = i->used, n = (size_t)s->n, l = (size_t)s->l, entries = (size_t)p->entries;
    double *C = take(i, entries), *turned = take(i, entries), *there = take(i, n), *zeros = take(i, n);
    double *size = take(i, l), *moved = take(i, l), *bent = take(i, l), known = 0.0, arm = 0.0, radius = INFINITY, found;
    Range *sizes = (Range *)take(i, 3 * entries), *amplitudes = (Range *)take(i, 3 * entries);
    Told *told = (Told *)take(i, 8 * l);
    memset(zeros, 0, n * sizeof *zeros);
    memset(told, 0, l * sizeof *told);
    constraints_at(i, q, zeros, NULL, C, NULL, NULL);
    coefficients(i, q, NULL, sizes, amplitudes);
    tell(s, sizes, amplitudes, told);
    for (int c = 0; c < s->n; c++)
        for (int e = p->offsets[c]; !metres(s, c) && e < p->offsets[c + 1]; e++) {
            const int r = p->indices[e];
            const double unit = s->rows[r].size > 0.0 ? s->rows[r].size : told[r].constant_length;
            if (strcmp(s->rows[r].unit, "m"))
                continue;
            known = fmax(known, unit > 0.0 ? amplitudes[e].most / unit : 0.0);
            arm = fmax(arm, amplitudes[e].most);
        }
    for (int k = 0; k < RANKED && arm == 0.0; k++) { /* One way alone may be along the radius, where nothing turns. */
        memset(size, 0, l * sizeof *size);
        memset(moved, 0, l * sizeof *moved);
        memset(bent, 0, l * sizeof *bent);
        for (int c = 0; c < s->n; c++)
            there[c] = q[c] + LITTLE * s->normal[k * s->n + c] * metres(s, c);
        constraints_at(i, there, zeros, NULL, turned, NULL, NULL);
        for (int c = 0; c < s->n; c++)
            for (int e = p->offsets[c]; metres(s, c) && e < p->offsets[c + 1]; e++) {
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
    i->used = used;
    return found >= 1e-300 && found < 1e12 && (found < 1 / ALIKE || found > ALIKE) ? found : 1.0;
}

Outcome assemble(Instance *i, const unsigned char *held, double *q, double *v)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *guess = take(i, (size_t)s->n);
    const double *x[] = {field(i, s->p), starts(i), starts(i) + s->starts};
    double *y[] = {guess, v};
    Loops loops = loops_new(i, held);
    const char *open;
    Outcome outcome;
    Mark begin;
    taped_call(i, s->guesses, x, y);
    *i->length = s->l ? own_length(i, guess) : 1.0;
    if (!isfinite(norm(guess, s->n)))
        outcome = say(
            i, FAILED, "%s: the start guess is not finite; check the dimensions and start values", s->name);
    else if ((open = without_gap(i, &loops, guess)))
        outcome = say(i, FAILED,
            "%s: at the start guess the gap of %s is not finite; check the dimensions, axes and start values", s->name, open);
    else {
        begin = tape_mark(i);
        outcome = positions(i, &loops, guess, q);
        if (outcome == DONE)
            keep_limits(i, &loops, guess, q, begin);
    }
    if (outcome == DONE) {
        check_guesses(i, &loops, guess, q);
        tape_closing(i, held, q, NULL, NULL, 1.0); /* Where it ends, the loops are closed. */
        outcome = rates(i, &loops, q, v);
    }
    i->used = used;
    return outcome;
}

/* The motion (n) that masses and constraints hold least, and how much they do: singular value of [M / scale; C]. */
static double weakest(Instance *i, Matrix M, Matrix C, double scale, double *motion)
{
    const Scene *s = i->scene;
    const int n = s->n, rows = n + s->l;
    const size_t used = i->used, side = (size_t)n;
    double *both = take(i, (size_t)rows * side), *V = take(i, side * side), *sizes = take(i, side), least;
    spread(M.pattern, M.values, both, rows);
    spread(C.pattern, C.values, both + n, rows);
    for (int c = 0; c < n; c++)
        for (int r = 0; r < n; r++)
            both[c * rows + r] /= scale;
    singular_values(rows, n, both, V, sizes);
    memcpy(motion, V + (n - 1) * n, side * sizeof *motion);
    least = sizes[n - 1];
    i->used = used;
    return least;
}

/* The same for many coordinates, by inverse iteration: eigenvalue of M / scale + C' C. */
static double weakest_of_many(Instance *i, Matrix M, Matrix C, double scale, double *motion)
{
    const Scene *s = i->scene;
    const Envelope *e = &s->holding;
    const size_t used = i->used;
    double *a = take(i, e->entries), *work = take(i, (size_t)s->n), size = 0.0;
    const Pattern *m = M.pattern, *p = C.pattern;
    memset(a, 0, e->entries * sizeof *a);
    for (int c = 0; c < s->n; c++) {
        for (int k = m->offsets[c]; k < m->offsets[c + 1]; k++)
            if (m->indices[k] <= c)
                *envelope_entry(e, a, c, m->indices[k]) += M.values[k] / scale;
    }
    /* Rows of C by products of its columns, where the envelope has room for what they have in common. */
    for (int c = 0; c < s->n; c++)
        for (int d = 0; d <= c; d++) {
            double sum = 0.0;
            if (e->place[d] < e->first[e->place[c]] || e->place[c] < e->first[e->place[d]])
                continue;
            for (int k = p->offsets[c], j = p->offsets[d]; k < p->offsets[c + 1] && j < p->offsets[d + 1];)
                if (p->indices[k] == p->indices[j])
                    sum += C.values[k++] * C.values[j++];
                else if (p->indices[k] < p->indices[j])
                    k++;
                else
                    j++;
            if (sum != 0.0)
                *envelope_entry(e, a, c, d) += sum;
        }
    envelope_factor(e, a, 1e-30 * fmax(1.0, largest(C.values, p->entries)));
    memcpy(motion, s->normal, (size_t)s->n * sizeof *motion);
    for (int pass = 0; pass < 4; pass++) {
        if (pass)
            envelope_solve(e, a, motion, motion, work);
        size = norm(motion, s->n);
        for (int c = 0; c < s->n; c++)
            motion[c] /= size;
    }
    i->used = used;
    return 1 / size;
}

Outcome check_masses(Instance *i, const double *q, const unsigned char *held)
{
    const Scene *s = i->scene;
    const size_t used = i->used, n = (size_t)s->n;
    const Matrix M = matrix_new(i, &s->mass), C = matrix_new(i, &s->constraint);
    double *motion = take(i, n), *zeros = take(i, n), scale, least;
    Outcome outcome = DONE;
    memset(zeros, 0, n * sizeof *zeros);
    constraints_at(i, q, zeros, M.values, C.values, NULL, NULL);
    for (int e = 0; e < s->constraint.entries; e++)
        C.values[e] *= held[s->constraint.indices[e]];
    scale = s->l ? fmax(largest(M.values, s->mass.entries), 1e-300) : 1.0;
    if (s->timed) /* Time needs no mass. */
        M.values[s->mass.entries - 1] = scale;
    least = (s->n <= DENSE ? weakest : weakest_of_many)(i, M, C, scale, motion);
    if (!(least > 1e-13)) {
        char free[300] = "";
        for (int c = 0; c < s->n; c++)
            if (fabs(motion[c]) > 0.1 && strlen(free) < 200) {
                strcat(free, *free ? ", " : "");
                strncat(free, s->coordinates[c].name, 80);
            }
        outcome = say(i, UNHELD,
            "%s: the motion along %s has no mass and no constraint that holds it (singular value %.0e of [M; C] at the "
            "start); a massless body must be held by constraints at both ends: never the last body of an open chain, "
            "never one placed by a joint coordinate alone",
            s->name, *free ? free : "some coordinates", least);
    }
    i->used = used;
    return outcome;
}

/* The constant coefficient of a row, of a length where it has any. */
static double constant(const Told *row)
{
    return row->lengths.count > 0.0 ? row->constant_length : row->constant;
}

/* Whether some coefficients tell the unit of their row: at a place that closes the loops, those of a slide across the row
   and of the attitude of a body that carries the whole loop are round-off. */
static int telling(const Told *row, Sum sum)
{
    return together(sum) > HARDLY * row->most;
}

/* What a row comes to for a unit of displacement, 0 where it has no coefficient: 1 in metres and radians, 1000 in
   millimetres. That is its constant coefficient; otherwise what its lengths come to together, or the constant amplitude
   of an angle. Of others it is not known but by the size of their coefficients. */
static double unit_of(const Told *row)
{
    return constant(row) > 0.0         ? constant(row)
        : telling(row, row->lengths)   ? sqrt(2.0) * together(row->lengths)
        : telling(row, row->euler)     ? together(row->euler)
        : row->angular > 0.0           ? row->angular
                                       : row->most;
}

/* Whether two rows are directions of one joint, which are square to each other. */
static int of_one_joint(const Scene *s, int a, int b)
{
    return a == b || (s->rows[a].size > 0.0 && s->rows[b].size > 0.0 && !strcmp(s->rows[a].name, s->rows[b].name));
}

/* How often each row is written: rows that are multiples of each other at all places have the same sums, over places and
   coordinates, of their coefficients by random numbers, over their size. Those of one joint are parts of one row, which the
   directions of its axes have divided among them. */
static void copies(Instance *i, const double *q, double *count)
{
    const Scene *s = i->scene;
    const Pattern *p = &s->constraint;
    const size_t used = i->used, n = (size_t)s->n, l = (size_t)s->l;
    double *C = take(i, (size_t)p->entries), *there = take(i, n), *zeros = take(i, n);
    double *sums = take(i, l), *squares = take(i, l), *parts = take(i, l);
    memset(zeros, 0, n * sizeof *zeros);
    memset(sums, 0, l * sizeof *sums);
    memset(squares, 0, l * sizeof *squares);
    for (int k = 0; k < PLACES; k++) {
        for (int c = 0; c < s->n; c++)
            there[c] = q[c] + aside[k] * s->normal[c] * (metres(s, c) ? LITTLE : 1.0);
        constraints_at(i, there, zeros, NULL, C, NULL, NULL);
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
                own += of_one_joint(s, r, other) ? parts[other] : 0.0;
            }
        count[r] = all > own && own > 0.0 ? all / own : 1.0; /* NaN equals no other row. */
    }
    i->used = used;
}

void default_penalties(Instance *i, const double *q, double *penalties)
{
    const Scene *s = i->scene;
    const Pattern *m = &s->mass, *p = &s->constraint;
    const size_t used = i->used, l = (size_t)s->l, entries = (size_t)p->entries;
    double *M = take(i, (size_t)m->entries), *held = take(i, (size_t)s->n), *written = take(i, l);
    double *units = i->units, mean = 0.0, heaviest = 0.0, wide = 0.0;
    Range *sizes = (Range *)take(i, 3 * entries), *amplitudes = (Range *)take(i, 3 * entries);
    Range all = {0.0, INFINITY, 0.0};
    Told *told = (Told *)take(i, 8 * l);
    int known = 1, every_angular = 1, every_exact = 1;
    coefficients(i, q, M, sizes, amplitudes);
    for (int c = 0; c < s->n; c++)
        for (int e = p->offsets[c]; metres(s, c) && e < p->offsets[c + 1]; e++) {
            Range *each[] = {sizes + e, amplitudes + e};
            for (int k = 0; k < 2; k++)
                *each[k] = (Range){each[k]->first * *i->length, each[k]->least * *i->length, each[k]->most * *i->length};
        }
    memset(told, 0, l * sizeof *told);
    tell(s, sizes, amplitudes, told);
    for (int r = 0; r < s->l; r++) {
        const int declared = s->rows[r].size > 0.0;
        units[r] = declared ? s->rows[r].size * (strcmp(s->rows[r].unit, "m") ? 1.0 : *i->length) : unit_of(told + r);
        known &= declared || constant(told + r) > 0.0 || telling(told + r, told[r].lengths) || told[r].angular > 0.0;
        every_angular &= told[r].angular > 0.0 && !declared;
        every_exact &= constant(told + r) > 0.0;
    }
    for (int r = 0; r < s->l; r++) {
        if (every_angular && !every_exact)
            units[r] = told[r].angular;
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
        double own = 0.0; /* of the directions of a joint together, as its axes may lie anywhere */
        held[c] = 0.0;
        for (int e = p->offsets[c]; e < p->offsets[c + 1]; e++) {
            const int r = p->indices[e], more = e > p->offsets[c] && of_one_joint(s, p->indices[e - 1], r);
            own = more ? hypot(own, sizes[e].most / units[r]) : sizes[e].most / units[r];
            held[c] = fmax(held[c], own);
        }
        wide = fmax(wide, held[c]);
    }
    for (int c = 0; c < s->n; c++)
        for (int e = m->offsets[c]; held[c] > HARDLY * wide && e < m->offsets[c + 1]; e++)
            if (m->indices[e] == c) {
                const double size = metres(s, c) ? 1 / *i->length : held[c];
                heaviest = fmax(heaviest, M[e] / (size * size));
            }
    /* The squares of a constraint that is written several times come to that of one: it holds as if written once. */
    copies(i, q, written);
    for (int r = 0; r < s->l; r++) {
        units[r] *= sqrt(written[r]);
        penalties[r] = PENALTY_RATIO * fmax(heaviest, 1e-300) / (units[r] * units[r]);
    }
    i->used = used;
}

/* Phi and C at q, each row times its weight. */
static void weighted_at(Instance *i, const double *q, const double *weights, Matrix C, double *phi)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *zeros = take(i, (size_t)s->n);
    memset(zeros, 0, (size_t)s->n * sizeof *zeros);
    constraints_at(i, q, zeros, NULL, C.values, phi, NULL);
    weigh_rows(C, weights);
    for (int r = 0; r < s->l; r++)
        phi[r] *= weights[r];
    i->used = used;
}

/* Singular values of C that are more than nothing. */
static int rank_of(Instance *i, Matrix C)
{
    const Scene *s = i->scene;
    const int wide = s->l < s->n, few = wide ? s->l : s->n, many = wide ? s->n : s->l;
    const size_t used = i->used;
    double *a = take(i, (size_t)many * (size_t)few), *V = take(i, (size_t)few * (size_t)few);
    double *sizes = take(i, (size_t)few);
    const double least = 1e-7 * fmax(1.0, largest(C.values, C.pattern->entries));
    int rank = 0;
    if (wide) {
        memset(a, 0, (size_t)many * (size_t)few * sizeof *a);
        for (int c = 0; c < s->n; c++)
            for (int e = C.pattern->offsets[c]; e < C.pattern->offsets[c + 1]; e++)
                a[C.pattern->indices[e] * s->n + c] = C.values[e];
    } else
        spread(C.pattern, C.values, a, s->l);
    singular_values(many, few, a, V, sizes);
    while (rank < few && sizes[rank] > least)
        rank++;
    i->used = used;
    return rank;
}

/* The same of many coordinates: rows that those before them do not make up, by the pivots of C C'. */
static int rank_of_many(Instance *i, const Rows *J)
{
    const Envelope *e = &i->scene->closing;
    const size_t used = i->used;
    double *a = take(i, e->entries), most = squared(i, J, a);
    int rank = 0;
    envelope_factor(e, a, DBL_MIN);
    for (int r = 0; r < i->scene->l; r++)
        rank += *envelope_entry(e, a, r, r) > DEPENDENT * most;
    i->used = used;
    return rank;
}

/* How many of these constraints are independent at q. */
int rank_here(Instance *i, const double *q, const unsigned char *held)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    const Rows J = {matrix_new(i, &s->constraint), matrix_new(i, &s->tie_rows)};
    double *weights = take(i, (size_t)s->l), *phi = take(i, (size_t)(s->l + s->ties));
    int rank;
    memset(J.ties.values, 0, (size_t)s->tie_rows.entries * sizeof *J.ties.values);
    for (int r = 0; r < s->l; r++)
        weights[r] = held[r];
    weighted_at(i, q, weights, J.constraints, phi);
    rank = s->n > DENSE ? rank_of_many(i, &J) : rank_of(i, J.constraints);
    i->used = used;
    return rank;
}

/* The correction of least norm with which a rank is told: where coordinates are few, it takes what C hardly holds. */
static void ranked_correction(Instance *i, const Rows *J, const double *r, double *x)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *C;
    if (s->n > DENSE) {
        least_correction(i, J, r, CORRECTIONS, x);
        return;
    }
    C = take(i, (size_t)s->l * (size_t)s->n);
    spread(J->constraints.pattern, J->constraints.values, C, s->l);
    least_norm(s->l, s->n, C, r, 1e-8, x, take(i, least_norm_work(s->l, s->n)));
    i->used = used;
}

/* S1: degrees of freedom at regular positions near q, and at q itself; `place` is one where the rank is largest. */
static int freedom_near(Instance *i, const double *q, const unsigned char *held, int *here, double *place)
{
    const Scene *s = i->scene;
    const size_t used = i->used, n = (size_t)s->n, l = (size_t)s->l, count = l + (size_t)s->ties;
    const int many = s->n > DENSE, places = many ? FEW_RANKED : RANKED;
    const double size = 0.3 * fmin(fmax(1.0, largest_of(i, q)), ALIKE) / sqrt(s->n);
    const Rows J = {matrix_new(i, &s->constraint), matrix_new(i, &s->tie_rows)};
    const Matrix C = J.constraints;
    double *phi = take(i, count), *weights = take(i, l), *units = take(i, l), *near = take(i, n), *dq = take(i, n);
    double *aside = take(i, n), most = 1.0;
    int rank, found;
    memset(J.ties.values, 0, (size_t)s->tie_rows.entries * sizeof *J.ties.values);
    memset(phi, 0, count * sizeof *phi);
    for (int r = 0; r < s->l; r++) {
        weights[r] = held[r];
        units[r] = 0.0;
    }
    for (int k = -1; k < places && !many; k++) { /* Rows in other units are as independent as before. */
        for (int c = 0; c < s->n; c++)
            near[c] = q[c] + (k < 0 ? 0.0 : size * (metres(s, c) ? *i->length : 1.0) * s->normal[k * s->n + c]);
        weighted_at(i, near, weights, C, phi);
        for (int e = 0; e < s->constraint.entries; e++)
            units[s->constraint.indices[e]] = fmax(units[s->constraint.indices[e]], fabs(C.values[e]));
    }
    most = fmax(most, largest(units, s->l));
    for (int r = 0; r < s->l; r++) /* A row of round-off alone stays small. */
        weights[r] = held[r] / (units[r] > SAME * most ? units[r] : 1.0);
    weighted_at(i, q, weights, C, phi);
    rank = many ? rank_of_many(i, &J) : rank_of(i, C);
    *here = s->n - rank;
    memcpy(place, q, n * sizeof *q);
    for (int k = 0; k < places; k++) {
        for (int c = 0; c < s->n; c++)
            aside[c] = size * (metres(s, c) ? *i->length : 1.0) * s->normal[k * s->n + c];
        if (many) { /* Along the motion: in a long chain any other way leads far from an assembly. */
            double most;
            weighted_at(i, q, weights, C, phi);
            times(C, aside, phi);
            least_correction(i, &J, phi, CORRECTIONS, dq);
            for (int c = 0; c < s->n; c++)
                aside[c] -= dq[c];
            most = fmax(largest_of(i, aside), 1e-300);
            for (int c = 0; c < s->n; c++)
                aside[c] *= 0.3 / most;
        }
        for (int c = 0; c < s->n; c++)
            near[c] = q[c] + aside[c];
        if (s->timed) /* Where time stands still, what is prescribed may have no regular position. */
            near[s->n - 1] += (k % 2 ? -LATER : LATER) * pow(0.1, (k / 2) % 4);
        for (int pass = 0;; pass++) {
            weighted_at(i, near, weights, C, phi);
            if (pass == 30 || largest(phi, s->l) <= 1e-16 * largest(near, s->n))
                break;
            ranked_correction(i, &J, phi, dq);
            for (int c = 0; c < s->n; c++)
                near[c] -= dq[c];
        }
        if (largest(phi, s->l) < 1e-9 && (found = many ? rank_of_many(i, &J) : rank_of(i, C)) > rank) {
            rank = found;
            memcpy(place, near, n * sizeof *near);
        }
    }
    i->used = used;
    return s->n - rank;
}

/* What corrections of first order leave of residues (l) of constraints that are in force. */
static void incorrigible(Instance *i, const Rows *J, const double *r, double *left)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *dq = take(i, (size_t)s->n);
    least_correction(i, J, r, CORRECTIONS, dq);
    all_times(J, dq, left);
    for (int k = 0; k < s->l; k++)
        left[k] = r[k] - left[k];
    i->used = used;
}

/* How far from a place (n) that is displaced along a motion the constraints lead back, over the displacement. */
static double led_back(Instance *i, const Rows *J, const double *weights, const double *q, const double *way, double size)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *near = take(i, (size_t)s->n), *dq = take(i, (size_t)s->n), *phi = take(i, (size_t)(s->l + s->ties)), found;
    memset(phi, 0, (size_t)(s->l + s->ties) * sizeof *phi);
    for (int c = 0; c < s->n; c++)
        near[c] = q[c] + size * way[c];
    for (int pass = 0; pass < MOST_RETURNS; pass++) {
        weighted_at(i, near, weights, J->constraints, phi);
        ranked_correction(i, J, phi, dq);
        for (int c = 0; c < s->n; c++)
            near[c] -= dq[c];
    }
    for (int c = 0; c < s->n; c++)
        near[c] -= q[c] + size * way[c];
    found = largest_of(i, near) / size;
    i->used = used;
    return found;
}

/* Joints of the rows that have most of a residue (l). */
static void list_joints(const Scene *s, const double *residue, char *names, size_t size)
{
    int said = 0;
    for (int r = 0, other; r < s->l; r++) {
        if (fabs(residue[r]) < 0.1 * largest(residue, s->l))
            continue;
        for (other = 0; other < r; other++)
            if (!strcmp(s->rows[other].name, s->rows[r].name) && fabs(residue[other]) >= 0.1 * largest(residue, s->l))
                break;
        if (other == r && said++ < SAID)
            snprintf(names + strlen(names), size - strlen(names), "%s%.40s", *names ? ", " : "", s->rows[r].name);
    }
}

/* Whether redundant constraints (l: those in force) can be judged at q: it is no singular position. */
static int judges(Instance *i, const unsigned char *held, const double *q)
{
    const Scene *s = i->scene;
    int active = 0;
    for (int r = 0; r < s->l; r++)
        active += held[r];
    return *i->rank < active && s->n <= DENSE && rank_here(i, q, held) == (int)*i->rank;
}

/* DONE, or which constraints contradict each other: by what corrections of first order leave of |Phi|, or of |Phi-dot|, at a
   regular position. */
Outcome check_agreement(Instance *i, const unsigned char *held, const double *q, const double *open, const char *per)
{
    const Scene *s = i->scene;
    const size_t used = i->used, count = (size_t)(s->l + s->ties);
    const Rows J = {matrix_new(i, &s->constraint), matrix_new(i, &s->tie_rows)};
    double *weights = take(i, (size_t)s->l), *residue = take(i, count), *left = take(i, count);
    int row = 0;
    char names[300] = "";
    Outcome outcome = DONE;
    memset(J.ties.values, 0, (size_t)s->tie_rows.entries * sizeof *J.ties.values);
    memset(residue, 0, count * sizeof *residue);
    for (int r = 0; r < s->l; r++)
        weights[r] = held[r];
    weighted_at(i, q, weights, J.constraints, left);
    for (int r = 0; r < s->l; r++)
        residue[r] = weights[r] * open[r];
    if (judges(i, held, q)) {
        incorrigible(i, &J, residue, left);
        for (int r = 1; r < s->l; r++)
            if (fabs(left[r]) / i->units[r] > fabs(left[row]) / i->units[row])
                row = r;
        list_joints(s, left, names, sizeof names);
        if (fabs(left[row]) / i->units[row] > i->values[s->tolerance])
            outcome = say(i, FAILED,
                "%s: constraints contradict each other: %s cannot be kept together, and %s is missed by %.3g %s%s; make their "
                "lengths, offsets and laws agree, or leave one of them out",
                s->name, names, s->rows[row].name, fabs(left[row]), s->rows[row].unit, per);
    }
    i->used = used;
    return outcome;
}

/* Warns of constraints that stop a motion at every place, but to second order alone: displaced along it they lead back, and
   no further where the displacement is smaller. */
void warn_of_second_order(Instance *i, const unsigned char *held, const double *q)
{
    const Scene *s = i->scene;
    const size_t used = i->used, n = (size_t)s->n, count = (size_t)(s->l + s->ties);
    const Rows J = {matrix_new(i, &s->constraint), matrix_new(i, &s->tie_rows)};
    const Matrix C = matrix_new(i, &s->constraint);
    double *weights = take(i, (size_t)s->l), *left = take(i, count), *gap = take(i, count), *way = take(i, n), *dq = take(i, n);
    double size, back = 0.0;
    char names[300] = "";
    if (!judges(i, held, q)) {
        i->used = used;
        return;
    }
    memset(J.ties.values, 0, (size_t)s->tie_rows.entries * sizeof *J.ties.values);
    memset(left, 0, count * sizeof *left);
    memset(gap, 0, count * sizeof *gap);
    for (int r = 0; r < s->l; r++)
        weights[r] = held[r];
    weighted_at(i, q, weights, J.constraints, left);
    for (int c = 0; c < s->n; c++)
        way[c] = (metres(s, c) ? *i->length : 1.0) * s->normal[c];
    times(J.constraints, way, left);
    ranked_correction(i, &J, left, dq);
    for (int c = 0; c < s->n; c++)
        way[c] -= dq[c];
    size = largest_of(i, way);
    for (int c = 0; c < s->n; c++)
        way[c] /= fmax(size, 1e-300);
    if (size > REGULAR)
        back = led_back(i, &J, weights, q, way, LITTLE);
    /* Along a motion the way back shrinks with the square of the displacement. */
    if (back > SECOND_ORDER && back > 0.5 * led_back(i, &J, weights, q, way, 10 * LITTLE)) {
        for (int c = 0; c < s->n; c++)
            dq[c] = q[c] + LITTLE * way[c];
        weighted_at(i, q, weights, J.constraints, left);
        weighted_at(i, dq, weights, C, gap);
        incorrigible(i, &J, gap, left);
        list_joints(s, left, names, sizeof names);
        warn(i, WARNED_OF_SECOND_ORDER,
            "%s: %s stop a motion to second order alone, wherever it is: no force of finite size does, and what loads that motion "
            "is not to be relied on; change lengths or offsets, or leave out what only this motion needs",
            s->name, names);
    }
    i->used = used;
}

/* S5: combinations (l x l, by columns) of constraints weighted by the root of the penalty, and their sizes at q. */
static void ranges(Instance *i, const double *q, double *combinations, double *sizes)
{
    const Scene *s = i->scene;
    const size_t used = i->used, n = (size_t)s->n, l = (size_t)s->l;
    const Matrix C = matrix_new(i, &s->constraint);
    double *turned = take(i, l * n), *zeros = take(i, n);
    memset(zeros, 0, n * sizeof *zeros);
    memset(turned, 0, l * n * sizeof *turned);
    constraints_at(i, q, zeros, NULL, C.values, NULL, NULL);
    for (int c = 0; c < s->n; c++)
        for (int e = C.pattern->offsets[c]; e < C.pattern->offsets[c + 1]; e++)
            turned[C.pattern->indices[e] * s->n + c] = sqrt(i->penalty[C.pattern->indices[e]]) * C.values[e];
    singular_values(s->n, s->l, turned, combinations, sizes);
    i->used = used;
}

/* S5: whether constraints that are redundant at q become independent beside the motion, and so would stop it. */
static int would_brake(Instance *i, const double *q, const double *way)
{
    const Scene *s = i->scene;
    const size_t used = i->used, n = (size_t)s->n, l = (size_t)s->l;
    const int rank = (int)*i->rank;
    const Matrix C = matrix_new(i, &s->constraint);
    double *combinations = take(i, l * l), *sizes = take(i, l), *there = take(i, n), found = 0.0;
    ranges(i, q, combinations, sizes);
    for (int c = 0; c < s->n; c++)
        there[c] = q[c] + aside[PLACES - 1] * way[c];
    constraints_at(i, there, way, NULL, C.values, NULL, NULL);
    for (int k = rank; k < s->l; k++)
        for (int c = 0; c < s->n; c++) {
            double sum = 0.0;
            for (int e = C.pattern->offsets[c]; e < C.pattern->offsets[c + 1]; e++) {
                const int r = C.pattern->indices[e];
                sum += combinations[k * s->l + r] * sqrt(i->penalty[r]) * C.values[e];
            }
            found = fmax(found, fabs(sum));
        }
    i->used = used;
    return sizes[rank - 1] >= REGULAR * sizes[0] && found > REGULAR * REGULAR * REGULAR * sizes[0];
}

/* The same for any place on the motion near the start. */
static int brakes_near(Instance *i, const double *q, const double *v)
{
    const Scene *s = i->scene;
    const size_t used = i->used, n = (size_t)s->n, count = (size_t)(s->l + s->ties);
    Rows J;
    double *way, *weights, *phi, *near, *dq, size;
    int active = 0, found = 0;
    for (int r = 0; r < s->l; r++)
        active += i->penalty[r] > 0.0;
    if (*i->rank >= active || *i->rank < 1.0 || s->n > DENSE)
        return 0;
    J = (Rows){matrix_new(i, &s->constraint), matrix_new(i, &s->tie_rows)};
    way = take(i, n);
    near = take(i, n);
    dq = take(i, n);
    phi = take(i, count);
    weights = take(i, (size_t)s->l);
    memset(phi, 0, count * sizeof *phi);
    memset(J.ties.values, 0, (size_t)s->tie_rows.entries * sizeof *J.ties.values);
    for (int r = 0; r < s->l; r++)
        weights[r] = i->penalty[r] > 0.0;
    memcpy(way, v, n * sizeof *way);
    if (largest(v, dependent(s)) == 0.0) { /* Any motion will do. */
        weighted_at(i, q, weights, J.constraints, phi);
        times(J.constraints, s->normal, phi);
        least_correction(i, &J, phi, CORRECTIONS, dq);
        for (int c = 0; c < s->n; c++)
            way[c] = s->normal[c] - dq[c];
    }
    size = fmax(largest_of(i, way), 1e-300);
    for (int c = 0; c < s->n; c++)
        way[c] /= size;
    for (int a = 0; a < PLACES && !found; a++) {
        for (int c = 0; c < s->n; c++)
            near[c] = q[c] + aside[a] * way[c];
        for (int pass = 0; pass <= CORRECTIONS; pass++) {
            weighted_at(i, near, weights, J.constraints, phi);
            if (pass == CORRECTIONS || largest(phi, s->l) <= TOLERANCE)
                break;
            least_correction(i, &J, phi, CORRECTIONS, dq);
            for (int c = 0; c < s->n; c++)
                near[c] -= dq[c];
        }
        found = largest(phi, s->l) <= GROSS && would_brake(i, near, way);
    }
    i->used = used;
    return found;
}

/* S5: freezes the rank of C at the state before a step. */
void hold(Instance *i)
{
    const Scene *s = i->scene;
    const size_t used = i->used, l = (size_t)s->l;
    const int rank = (int)*i->rank;
    double *combinations, *sizes, *matrix = field(i, s->k) + SETTINGS + 2 * s->l + s->n + s->compliances;
    if (rank < 1 || rank > s->l || s->n > DENSE)
        return;
    combinations = take(i, l * l);
    sizes = take(i, l);
    /* S5: at a singular position the combinations of the place before it are kept. */
    ranges(i, field(i, s->z), combinations, sizes);
    if (sizes[rank - 1] > REGULAR * sizes[0]) {
        for (int a = 0; a < s->l; a++)
            for (int b = 0; b < s->l; b++) {
                double sum = 0.0;
                for (int k = 0; k < rank; k++)
                    sum += combinations[k * s->l + a] * combinations[k * s->l + b];
                matrix[a * s->l + b] = sqrt(i->penalty[a]) * sum * sqrt(i->penalty[b]) / *i->largest_penalty;
            }
        tape_holding(i, field(i, s->z), matrix);
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
    int freedom = s->freedom + s->timed, count = 1, second, here;
    if (!usual || s->freedom < 0)
        freedom = freedom_near(i, q, held, &here, there);
    *i->rank = s->n - freedom;
    /* Masses are not known yet. */
    k[SETTINGS_NOTHING] = 0.0;
    for (int c = 0; c < s->n; c++)
        inverse_scales[c] = 1.0;
    memcpy(way, v, n * sizeof *way);
    memset(touched, 0, n * sizeof *touched);
    memset(i->scales, 0, n * sizeof *i->scales);
    if (largest(v, dependent(s)) == 0.0) {
        const double *x[] = {q, there, v, p, k};
        double *y[] = {way, rate};
        for (int c = 0; c < s->n; c++)
            there[c] = q[c] + (metres(s, c) ? *i->length : 1.0) * s->normal[c];
        call(i, s->bring, x, y);
        for (int c = 0; c < s->n; c++)
            way[c] -= q[c];
    }
    size = fmax(largest_of(i, way), 1e-300);
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
    i->flags.brakes = brakes_near(i, q, v);
    for (int a = 0; a < count; a++) {
        const double *x[] = {places + a * n, p, k};
        double *y[] = {pivots, diagonal, columns, &margin};
        int bad = 0;
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
    /* Where a coordinate cannot tell the motion its pivot is far larger; at a singular position it may be smaller, and the
       start, which may be one, is there twice. */
    sort(together, count);
    *i->regular = (together[(count - 1) / 2] + together[count / 2]) / 2 + log(REGULAR_PRODUCT);
    sort(found, count);
    second = found[1] == found[0] ? 2 : 1;
    while (count > second && !(found[count - 1] <= found[second] + FAR_RATIO))
        count--;
    *i->masses = floor((found[(count - 1) / 2] + found[count / 2]) / 2 * COARSE + 0.5) / COARSE;
    for (int c = 0; c < s->n; c++)
        i->scales[c] = (float)i->scales[c];
    i->used = used;
}

/* Of the constraints in force, of all of them, or of those in force without what dry friction holds; also a place (n) near the
   present one at which they are told. */
Outcome instance_mobility(Instance *i, Counted_rows which, int *freedom, int *redundant, int *here, double *place)
{
    const Scene *s = i->scene;
    unsigned char *held;
    i->used = 0;
    memcpy(place, field(i, s->z), (size_t)s->n * sizeof *place);
    *freedom = *here = dependent(s);
    *redundant = 0;
    if (!i->flags.initialized)
        return say(i, REFUSED, "%s: its degrees of freedom are known after initialising", s->name);
    if (!s->l)
        return DONE;
    held = (unsigned char *)take(i, (size_t)s->l);
    for (int r = 0; r < s->l; r++)
        held[r] = which == ALL_ROWS || i->penalty[r] > 0.0;
    for (int k = 0; k < s->frictions && which == NO_FRICTION; k++)
        held[s->friction[k].row] = 0;
    for (int r = 0; r < s->l; r++)
        *redundant += held[r];
    *freedom = freedom_near(i, field(i, s->z), held, here, place) - s->timed;
    *here -= s->timed;
    *redundant -= dependent(s) - *freedom;
    i->used = 0;
    return DONE;
}
