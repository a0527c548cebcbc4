#include "assemble.h"

#include <stdio.h>

#include "equations.h"
#include "guesses.h"
#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "linear.h"
#include "loops.h"
#include "message.h"
#include "quantity.h"
#include "record.h"
#include "row_units.h"
#include "scene.h"
#include "velocities.h"

/* An assembly other than the one in which the start ends (`own`), and its distance from the guess. */
typedef struct {
    const double *own;
    double *q, way;
} Another;

/* Find the assembly nearest to the guess from positions around it; return the number of that position, -1 if none leads
   to an assembly. `another` becomes the nearest one that differs from its `own`. */
static int find_nearest(Instance *i, Loops *loops, const double *guess, double size, double *found, Another *another)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *q = arena_alloc(i, (size_t)s->n), best = INFINITY;
    int from = -1;
    const int paused = tape_pause(i, 1);
    another->way = INFINITY;
    for (int k = 0; k < TRIES; k++) {
        double away;
        int most;
        loops_beside_guess(i, loops, guess, size, k, q);
        loops_follow(i, loops, q);
        if (!loops_close(i, loops, q))
            continue;
        away = loops_way(i, loops, guess, q, &most);
        if (away < best) {
            best = away;
            from = k;
            memcpy(found, q, (size_t)s->n * sizeof *q);
        }
        away = coordinates_apart(s, loops->columns, guess, q);
        if (away < another->way && coordinates_apart(s, loops->units, another->own, q) > DISTINCT) {
            another->way = away;
            for (int c = 0; c < s->n; c++) /* Remove whole turns: a reader compares these angles with the guess. */
                another->q[c] = guess[c] + coordinate_shortest_way(s, c, q[c] - guess[c]);
        }
    }
    tape_pause(i, paused);
    arena_release(i, arena);
    return from;
}

/* Return whether start values determine the assembly: the loops close there again from a position beside it. */
static int start_values_determine(Instance *i, Loops *loops, const double *assembly)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *q = arena_alloc(i, (size_t)s->n);
    const int paused = tape_pause(i, 1);
    int back;
    for (int c = 0; c < s->n; c++)
        q[c] = assembly[c] + loops->units[c] * DISTINCT * s->normal[c] / sqrt(s->n);
    loops_follow(i, loops, q);
    tape_pause(i, paused);
    back = loops_close(i, loops, q) && coordinates_apart(s, loops->units, assembly, q) < DISTINCT * DISTINCT;
    arena_release(i, arena);
    return back;
}

/* Return the length that changes most, by more than AWAY, from one sign to the other between two positions; -1 if there
   is none. Angles are ignored: from a rough guess they change sign even if the assembly looks the same. */
static int find_changed_side(const Scene *s, const Loops *loops, const double *from, const double *to)
{
    int most = -1;
    double longest = AWAY;
    for (int c = 0; c < s->n; c++) {
        const double change = fabs(to[c] - from[c]) / loops->units[c];
        if (coordinate_is_length(s, c) && from[c] * to[c] < 0.0 && change > longest) {
            longest = change;
            most = c;
        }
    }
    return most;
}

/* Warn if another assembly is about as near to the guess, or if a length has the other sign than its guess. */
static Outcome warn_of_other_assembly(
    Instance *i, Loops *loops, const double *guess, const double *q, const Another *another)
{
    const Scene *s = i->scene;
    char own[QUANTITY], given[QUANTITY], other[QUANTITY];
    int most, c = find_changed_side(s, loops, guess, q);
    if (another->way < BETWEEN * coordinates_apart(s, loops->columns, guess, q)
        && start_values_determine(i, loops, q)) {
        loops_way(i, loops, q, another->q, &most);
        instance_say(i, DONE,
            "%s: the guess lies between two assemblies; in the one taken %s is %s, guessed as %s, and in the other, "
            "hardly "
            "farther from the guess, it is %s; give start values or guesses closer to the assembly you want",
            s->name, s->coordinates[most].name, quantity_in_unit(s->coordinates[most].unit, q[most], own),
            quantity_in_unit(s->coordinates[most].unit, guess[most], given),
            quantity_in_unit(s->coordinates[most].unit, another->q[most], other));
    } else if (c >= 0)
        instance_say(i, DONE,
            "%s: the loops closed where %s is %s, guessed as %s on the other side of zero, and no nearer assembly was "
            "found; "
            "check lengths and offsets, or give start values or guesses closer to this assembly",
            s->name, s->coordinates[c].name, quantity_in_unit(s->coordinates[c].unit, q[c], own),
            quantity_in_unit(s->coordinates[c].unit, guess[c], given));
    return DONE;
}

/* Refuse loops that do not close; name a start value with which they do, if there is one. */
static Outcome report_not_closed(Instance *i, Loops *loops, const double *guess, double *q)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n;
    double *other = arena_alloc(i, n), most = 0.0;
    Another another = {q, arena_alloc(i, n), INFINITY};
    char label[200], hint[400] = "", own[QUANTITY], given[QUANTITY];
    int worst = -1, contradict;
    loops_evaluate(i, loops, q);
    contradict = linear_largest(loops->residue, s->l) <= ROUGH;
    loops_gap_label(i, loops, label, sizeof label);
    if (s->ties && !contradict) { /* Let start values give way, too. */
        memcpy(other, guess, n * sizeof *other);
        loops->untied = 1;
        loops_follow(i, loops, other);
        if (loops_close(i, loops, other) || find_nearest(i, loops, guess, 3.0, other, &another) >= 0) {
            loops->untied = 0;
            loops_evaluate(i, loops, other);
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
        const double value = loops_starts(i)[s->tied[worst]];
        snprintf(hint, sizeof hint, "; they close where %s is %s instead of %s", start->name,
            quantity_in_unit(start->unit, value + loops->residue[s->l + worst], own),
            quantity_in_unit(start->unit, value, given));
    }
    arena_release(i, arena);
    return instance_say(i, FAILED, "%s: %s; corrections of the guess leave %s; %s%s", s->name,
        contradict ? "the start values contradict each other" : "the loops cannot be closed", label,
        s->ties > 1 ? "give fewer or consistent start values" : "check lengths, offsets and start values", hint);
}

static Outcome close_positions(Instance *i, Loops *loops, const double *guess, double *q)
{
    const Scene *s = i->scene;
    const Mark begin = tape_mark(i);
    double step, moved, size, away = INFINITY, *other = arena_alloc(i, (size_t)s->n);
    Another another = {q, arena_alloc(i, (size_t)s->n), INFINITY};
    char own[QUANTITY], given[QUANTITY], theirs[QUANTITY];
    int most, from, direct, unguessed = 0;
    i->text[0] = '\0';
    memcpy(q, guess, (size_t)s->n * sizeof *q);
    tape_copy(i, q, guess, (size_t)s->n);
    step = loops_follow(i, loops, q);
    moved = loops_close(i, loops, q) ? loops_way(i, loops, guess, q, &most) : INFINITY;
    direct = moved <= 1.5 * step + 1e-6;
    size = fmax(moved, coordinates_apart(s, loops->units, guess, q)); /* the distance without weights */
    if (direct && (size <= AWAY || s->n > DENSE))
        return DONE;
    /* The correction is long or failed: look for an assembly nearer to the guess. */
    size = fmin(size, 3.0);
    from = find_nearest(i, loops, guess, size, other, &another);
    if (from >= 0)
        away = loops_way(i, loops, guess, other, &most);
    for (int c = 0; c < s->n; c++)
        unguessed |= s->readiness[c] > 1.0;
    direct &= away >= NEARER * moved || !unguessed;
    if (direct) {
        if (away < NEARER * moved) {
            loops_way(i, loops, q, other, &most);
            instance_say(i, DONE,
                "%s: the loops closed far from the guess, where %s is %s, guessed as %s, and in a nearer assembly it "
                "is %s; "
                "give start values or guesses closer to the assembly you want",
                s->name, s->coordinates[most].name, quantity_in_unit(s->coordinates[most].unit, q[most], own),
                quantity_in_unit(s->coordinates[most].unit, guess[most], given),
                quantity_in_unit(s->coordinates[most].unit, other[most], theirs));
        }
        return away < NEARER * moved ? DONE : warn_of_other_assembly(i, loops, guess, q, &another);
    }
    if (from < 0 && moved == INFINITY)
        return report_not_closed(i, loops, guess, q);
    if (from >= 0 && away < 0.99 * moved) { /* The correction from the guess does not lead to the nearest assembly. */
        memcpy(another.q, q, (size_t)s->n * sizeof *q);
        another.way = moved < INFINITY ? coordinates_apart(s, loops->columns, guess, q) : INFINITY;
        tape_cut(i, begin);
        loops_beside_guess(i, loops, guess, size, from, q);
        tape_copy(i, q, guess, (size_t)s->n);
        loops_follow(i, loops, q);
        if (unguessed) /* The guessed coordinates decide which assembly is meant. */
            return warn_of_other_assembly(i, loops, guess, q, &another);
        loops_way(i, loops, guess, q, &most);
        return instance_say(i, DONE,
            "%s: no short way leads from the guess to closed loops; in the nearest assembly found, which is taken, %s "
            "is %s, "
            "guessed as %s; give start values or guesses closer to the assembly you want",
            s->name, s->coordinates[most].name, quantity_in_unit(s->coordinates[most].unit, q[most], own),
            quantity_in_unit(s->coordinates[most].unit, guess[most], given));
    }
    return warn_of_other_assembly(i, loops, guess, q, &another);
}

/* Return the name of a joint or start value whose gap at the guess is not finite; NULL if all are finite. */
static const char *find_undefined_gap(Instance *i, Loops *loops, const double *guess)
{
    const Scene *s = i->scene;
    loops_evaluate(i, loops, guess);
    for (int k = 0; k < loops->count; k++)
        if (!isfinite(loops->residue[k]))
            return k < s->l ? s->rows[k].name : s->variables[s->own + s->tied[k - s->l]].name;
    return NULL;
}

Outcome start_assemble(Instance *i, const unsigned char *held, double *q, double *v)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *guess = arena_alloc(i, (size_t)s->n), own;
    const double *x[] = {instance_field(i, s->p), loops_starts(i), loops_starts(i) + s->starts};
    double *y[] = {guess, v};
    Loops loops;
    const char *open;
    Outcome outcome;
    Mark begin;
    function_call_recorded(i, s->guesses, x, y);
    own = s->l ? units_own_length(i, guess, i->loop) : 1.0;
    *i->length = own < 1 / ALIKE || own > ALIKE ? own : 1.0; /* unit of displacements */
    loops = loops_new(i, held, own);
    if (!isfinite(linear_norm(guess, s->n)))
        outcome = instance_say(
            i, FAILED, "%s: the start guess is not finite; check the dimensions and start values", s->name);
    else if ((open = find_undefined_gap(i, &loops, guess)))
        outcome = instance_say(i, FAILED,
            "%s: at the start guess the gap of %s is not finite; check the dimensions, axes and start values", s->name,
            open);
    else {
        begin = tape_mark(i);
        outcome = close_positions(i, &loops, guess, q);
        if (outcome == DONE)
            guesses_keep_limits(i, &loops, guess, q, begin);
    }
    if (outcome == DONE) {
        guesses_check(i, &loops, guess, q);
        tape_correction(i, loops.rows, loops.columns, q, NULL, NULL, NULL, 1.0); /* At its end the loops are closed. */
        outcome = start_rates(i, &loops, q, v);
    }
    arena_release(i, arena);
    return outcome;
}
