#include "guesses.h"

#include <stdio.h>

#include "equations.h"
#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "loops.h"
#include "message.h"
#include "quantity.h"
#include "record.h"
#include "scene.h"

/* Return the distance of an angle or a length of an assembly from its guess, relative to its tolerance; zero may mean
   that there is no guess. */
static double find_missed_start(const Instance *i, int c, const double *guess, const double *q)
{
    const Scene *s = i->scene;
    const double length = MISSED_LENGTHS * fmax(*i->length, fabs(guess[c]));
    const double tolerance = coordinate_is_angle(s, c) ? MISSED : coordinate_is_length(s, c) ? length : INFINITY;
    return guess[c] != 0.0 ? fabs(coordinate_shortest_way(s, c, q[c] - guess[c])) / tolerance : 0.0;
}

/* Return whether the loops close if angles that were missed, or exceed a turn, are read as degrees; `meant` becomes
   that guess, and `there` the assembly near it. */
static int fits_in_degrees(
    Instance *i, Loops *loops, const double *guess, const double *q, double *meant, double *there)
{
    const Scene *s = i->scene;
    const int paused = tape_pause(i, 1);
    int fits = 0;
    for (int c = 0; c < s->n; c++) {
        const int beyond = coordinate_is_angle(s, c) && fabs(guess[c]) > 4 * QUARTER,
                  off = find_missed_start(i, c, guess, q) > 1.0;
        fits |= (coordinate_is_angle(s, c) && off) || (beyond && fabs(q[c] - guess[c]) > DISTINCT);
        meant[c] = there[c] = guess[c] * (beyond || (coordinate_is_angle(s, c) && off) ? QUARTER / 90 : 1.0);
    }
    if (fits)
        loops_follow(i, loops, there);
    fits = fits && loops_close(i, loops, there) && coordinates_apart(s, loops->units, there, q) > DISTINCT;
    for (int c = 0; c < s->n; c++)
        fits &= meant[c] == guess[c] || fabs(coordinate_shortest_way(s, c, there[c] - meant[c])) < AWAY;
    tape_pause(i, paused);
    return fits;
}

/* If there is no warning, warn of guesses far from which the loops closed; angles in degrees replace any warning. */
void guesses_check(Instance *i, Loops *loops, const double *guess, const double *q)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *meant = arena_alloc(i, (size_t)s->n), *there = arena_alloc(i, (size_t)s->n);
    char list[sizeof i->text / 2] = "", own[QUANTITY], given[QUANTITY], other[QUANTITY];
    const int degrees = fits_in_degrees(i, loops, guess, q, meant, there);
    int found = 0;
    for (int c = 0; c < s->n && (degrees || !*i->text); c++) {
        const char *name = s->coordinates[c].name, *unit = s->coordinates[c].unit;
        const double turns = fabs(guess[c]) > 4 * QUARTER && coordinate_is_angle(s, c)
            ? q[c] - coordinate_shortest_way(s, c, q[c])
            : 0.0;
        char *end = list + strlen(list);
        if (degrees ? meant[c] == guess[c] : find_missed_start(i, c, guess, q) <= 1.0)
            continue;
        quantity_in_unit(unit, q[c] - turns, own);
        quantity_in_unit(unit, guess[c], given);
        if (++found > SAID / 2)
            continue;
        if (degrees)
            snprintf(end, sizeof list - strlen(list), "%s%.40s is %s, guessed as %s, and would be %s",
                found > 1 ? "; " : "", name, own, given, quantity_in_unit(unit, there[c], other));
        else
            snprintf(end, sizeof list - strlen(list), "%s%.40s is %s, guessed as %s", found > 1 ? "; " : "", name, own,
                given);
    }
    if (found > SAID / 2)
        snprintf(list + strlen(list), sizeof list - strlen(list), "; and %d more", found - SAID / 2);
    if (degrees)
        instance_say(i, DONE,
            "%s: the loops closed far from the guesses, which read as degrees would fit another assembly: %s; give "
            "guesses in rad",
            s->name, list);
    else if (found)
        instance_say(i, DONE,
            "%s: the loops closed far from the guesses: %s; give guesses closer to the assembly you want", s->name,
            list);
    arena_release(i, arena);
}

/* Compute the excess of each displacement over its limit at q; `J` (limits x n, by columns) may be NULL. */
static void evaluate_limits(Instance *i, const double *q, double *beyond, double *J)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    const double *x[] = {q, instance_field(i, s->p)};
    double *y[] = {beyond, J ? J : arena_alloc(i, (size_t)s->limit_count * (size_t)s->n)};
    function_call(i, s->stops, x, y);
    arena_release(i, arena);
}

/* Return the largest excess of q over a limit beyond the allowed excess; lengths are divided by the mechanism's. */
static double find_worst_limit(Instance *i, const double *q, const double *allowed, int *worst)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *beyond = arena_alloc(i, (size_t)s->limit_count), most = -INFINITY;
    evaluate_limits(i, q, beyond, NULL);
    for (int k = 0; k < s->limit_count; k++) {
        const double left = (beyond[k] - allowed[k]) / (strcmp(s->limited[k].unit, "m") ? 1.0 : *i->length);
        if (left > most) {
            most = left;
            *worst = k;
        }
    }
    arena_release(i, arena);
    return most;
}

/* Return whether alternate corrections of loops and of limits lead from q to an assembly within limits. */
static int bring_within_limits(Instance *i, Loops *loops, const double *allowed, double *q)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n, count = (size_t)s->limit_count;
    double *beyond = arena_alloc(i, count), *J = arena_alloc(i, count * n), *way = arena_alloc(i, n), size = INFINITY,
           square, part;
    int worst;
    for (int pass = 0; pass < MOST && size > 0.0; pass++) {
        loops_follow(i, loops, q);
        size = loops_close(i, loops, q) ? find_worst_limit(i, q, allowed, &worst) : NAN;
        if (!(size > 0.0))
            break;
        evaluate_limits(i, q, beyond, J);
        memset(way, 0, n * sizeof *way);
        size = square = part = 0.0;
        for (int k = 0; k < s->limit_count; k++) { /* Aim slightly within the limits, so that few passes are made. */
            const double unit = strcmp(s->limited[k].unit, "m") ? 1.0 : *i->length;
            const double left = beyond[k] > allowed[k] ? (beyond[k] - allowed[k]) / unit + DISTINCT / 10 : 0.0;
            size += left * left;
            for (int c = 0; c < s->n; c++)
                way[c]
                    += left * J[(size_t)c * count + (size_t)k] * (coordinate_is_length(s, c) ? *i->length : 1.0) / unit;
        }
        for (int c = 0; c < s->n; c++) {
            square += way[c] * way[c];
            part = fmax(part, fabs(way[c]));
        }
        if (square < 1e-300)
            break;
        part = fmin(size / square, LONGEST_TURN / part);
        for (int c = 0; c < scene_coordinates(s); c++)
            q[c] -= part * way[c] * (coordinate_is_length(s, c) ? *i->length : 1.0);
    }
    arena_release(i, arena);
    return size <= 0.0;
}

/* If q is far beyond the limit of a stop, look for assemblies within the limits and take the nearest one. A limit may
   be exceeded as far as the guess exceeds it. */
void guesses_keep_limits(Instance *i, Loops *loops, const double *guess, double *q, Mark begin)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n;
    double *allowed, *tried, *found, nearest_way = INFINITY, left, away;
    char how[QUANTITY], own[QUANTITY], given[QUANTITY];
    int worst, most;
    if (!s->limit_count || s->n > DENSE)
        return;
    allowed = arena_alloc(i, (size_t)s->limit_count);
    tried = arena_alloc(i, n);
    found = arena_alloc(i, n);
    evaluate_limits(i, guess, allowed, NULL);
    for (int k = 0; k < s->limit_count; k++)
        allowed[k] = fmax(allowed[k], 0.0);
    left = find_worst_limit(i, q, allowed, &worst);
    if (left > DISTINCT) { /* A smaller excess is the load on the stop. */
        const int paused = tape_pause(i, 1);
        for (int k = -1; k < TRIES; k++) {
            memcpy(tried, q, n * sizeof *tried);
            if (k >= 0)
                loops_beside_guess(i, loops, guess, 3.0, k, tried);
            away = bring_within_limits(i, loops, allowed, tried) ? coordinates_apart(s, loops->columns, guess, tried)
                                                                 : INFINITY;
            if (away < nearest_way) {
                nearest_way = away;
                memcpy(found, tried, n * sizeof *found);
            }
        }
        tape_pause(i, paused);
        quantity_in_unit(s->limited[worst].unit, left * (strcmp(s->limited[worst].unit, "m") ? 1.0 : *i->length), how);
        if (nearest_way < INFINITY) {
            tape_cut(i, begin);
            memcpy(q, found, n * sizeof *q);
            tape_copy(i, q, guess, n);
            loops_way(i, loops, guess, q, &most);
            instance_say(i, DONE,
                "%s: the assembly nearest to the guess exceeds %s by %s; the nearest found within limits is taken, "
                "where %s is %s, guessed as %s; give start values or guesses closer to the assembly you want",
                s->name, s->limited[worst].name, how, s->coordinates[most].name,
                quantity_in_unit(s->coordinates[most].unit, q[most], own),
                quantity_in_unit(s->coordinates[most].unit, guess[most], given));
        } else
            instance_say(i, DONE,
                "%s: no assembly within limits was found; the one taken exceeds %s by %s; check the limits, lengths "
                "and start values",
                s->name, s->limited[worst].name, how);
    }
    arena_release(i, arena);
}
