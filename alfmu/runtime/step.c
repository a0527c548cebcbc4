/* The tiers of a step and what makes a communication step of them. */

#include <float.h>
#include <math.h>
#include <string.h>

#include "alfmu.h"
#include "tape.h"

/* Internal steps from one question to the next, whether a run goes on. */
#define LOOK 64

/* Last digits of a time that a step takes at least. */
#define LEAST_DIGITS 16

/* Jumps by the motion that are crossed by steps as short as may be, before a step that is so many times as long. */
#define CROSSINGS 4
#define AWAY_FROM_IT 1e3

/* Whether the caller of a run has ended it. */
int ended(Instance *i)
{
    if (i->go_on && !i->ended && ++i->looks % LOOK == 0)
        i->ended = !i->go_on(i);
    return i->ended;
}

/* Whether the evaluation that a quick step begins with has been made when outputs were read. */
static int read_here(const Instance *i)
{
    const Scene *s = i->scene;
    const size_t state = 2 * (size_t)s->n * sizeof *i->m;
    return i->onward && i->flags.known && !memcmp(i->read_at, i->m + s->z, state)
        && !memcmp(i->read_at + 2 * s->n, i->m + s->u, (size_t)s->inputs * sizeof *i->m);
}

/* Whether a quick step from where that evaluation was made would be found out to begin near a singular position. */
static int read_near(const Instance *i)
{
    const Scene *s = i->scene;
    return i->m[s->k + SETTINGS_CONTINUES] != 0.0 && i->workspace[s->read_watch + WATCH_NEAR] != 0.0;
}

/* What a step has led to is the state from now on. */
void arrive(Instance *i)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *begin = s->peaks ? take(i, state_length(s)) : NULL;
    if (begin)
        memcpy(begin, i->m + s->z, state_length(s) * sizeof *begin);
    memcpy(i->m + s->z, i->m + s->after, state_length(s) * sizeof *i->m);
    tape_copy(i, i->m + s->z, i->m + s->after, state_length(s));
    count_turns(i);
    if (s->entries)
        jacobian_along(i);
    if (begin)
        peaks_along(i, begin);
    i->used = used;
}

/* Internal steps until one cannot be made, each by the first tier that can make it; returns how many were. */
long advance(Instance *i, long steps, double dt)
{
    const Scene *s = i->scene;
    const int tiers[] = {s->quick, s->careful, s->branch_step};
    double *m = i->m, *after = m + s->after;
    long done;
    m[s->dt] = dt;
    for (done = 0; done < steps && !ended(i); done++) {
        int tier = m[s->control + CONTROL_TIER] != 0.0;
        const int onward = done == 0 && tier == 0 && s->onward >= 0 && read_here(i);
        if (onward && s->branch_step >= 0 && read_near(i))
            tier = 2;
        for (;;) {
            const Mark begin = tape_mark(i);
            run(i, onward && tier == 0 ? s->onward : tiers[tier]);
            if (after[s->trouble] == 0.0)
                break;
            tape_cut(i, begin);
            /* Near a singular position no step but that on the branch can be good. */
            if (tier == 2 || (tier == 1 && after[s->near] == 0.0))
                return done;
            tier = after[s->near] != 0.0 ? 2 : 1;
            if (tiers[tier] < 0)
                return done;
        }
        arrive(i);
        m[s->tally + tier] += 1.0;
        i->shared += onward && tier == 0;
        if (tier == 2)
            m[s->tally + TALLY_LIMITS] += after[s->near];
    }
    return done;
}

/* Whether constraints may depend on each other here that usually do not. */
static int irregular(Instance *i)
{
    const Scene *s = i->scene;
    double found = 1.0;
    const double *x[] = {i->m + s->z, i->m + s->p, i->m + s->k};
    double *y[] = {&found};
    if (s->irregular >= 0)
        call(i, s->irregular, x, y);
    return found != 0.0;
}

/* The numbers of step control for short steps in place of those for steps of the method, or the other way round. */
static void turn_to(double *pace, int kind)
{
    double *own = pace + PACE_DT, *other = pace + PACE_OTHER_DT;
    if (kind == (pace[PACE_SHORT] != 0.0))
        return;
    for (int k = 0; k < 3; k++) {
        const double kept = own[k];
        own[k] = other[k];
        other[k] = kept;
    }
    if (own[0] == 0.0) { /* No short step has been tried. */
        own[0] = other[0];
        own[1] = LEAST_BEFORE;
    }
    pace[PACE_SHORT] = kind;
    pace[PACE_LAST] = 0.0; /* What the method keeps from step to step does not lead on from here. */
}

/* Whether short steps reach the end with clearly fewer evaluations than those of the method; they are made for penalties
   that are scaled with the masses, of constraints that are all in force. */
static int short_ones(const Instance *i, double left)
{
    const Scene *s = i->scene;
    const double *pace = i->m + s->pace;
    const int kind = pace[PACE_SHORT] != 0.0;
    const double own = pace[PACE_DT], other = pace[PACE_OTHER_DT] > 0.0 ? pace[PACE_OTHER_DT] : own;
    if (s->short_step < 0 || pace[PACE_FIXED] != 0.0 || i->m[s->control + CONTROL_TIER] != 0.0)
        return 0;
    return EXACTER * s->short_cost * ceil(left / (kind ? own : other))
        <= s->method_cost * ceil(left / (kind ? other : own));
}

/* A try of a short step, on the branch near a singular position; 0 where it cannot be judged, or there is not accepted: the
   limits taken there are less exact for short steps. */
static int try_short(Instance *i)
{
    const Scene *s = i->scene;
    double *m = i->m, *after = m + s->after, *pace = m + s->pace, *tally = m + s->tally;
    double kept[PACE];
    const int onward = s->short_onward >= 0 && read_here(i);
    int near = onward && s->short_beside >= 0 && read_near(i);
    tally[TALLY_SHORT_TRIES] += 1.0;
    if (near)
        i->shared += s->short_cost; /* None of them is made. */
    else {
        run(i, onward ? s->short_onward : s->short_step);
        i->shared += onward;
        if (after[s->trouble] == 0.0)
            return 1;
        near = after[s->near] != 0.0;
        if (!near)
            pace[PACE_DT] *= SHORTENED;
    }
    if (!near || s->short_beside < 0)
        return 0;
    memcpy(kept, pace, sizeof kept);
    run(i, s->short_beside);
    tally[TALLY_SHORT_BESIDE] += 1.0;
    tally[TALLY_SHORT_LIMITS] += after[s->near];
    if (after[s->trouble] == 0.0 && pace[PACE_ACCEPTED] != 0.0)
        return 1;
    memcpy(pace, kept, sizeof kept);
    return 0;
}

/* Whether the error of a step is what round-off leaves of it. */
static int rounded(const Instance *i)
{
    return i->m[i->scene->pace + PACE_FLOOR] * i->scene->share > NOISE;
}

/* A try of an explicit step in place of one of the method, from the same numbers of step control; whether it can be judged.
   What only round-off excuses cannot. */
static int in_place(Instance *i, const double *kept, int regular)
{
    const Scene *s = i->scene;
    const double *after = i->m + s->after;
    double *pace = i->m + s->pace, *tally = i->m + s->tally;
    memcpy(pace, kept, PACE * sizeof *pace);
    run(i, regular ? s->regular_step : s->beside);
    pace[PACE_LAST] = 0.0; /* What the method keeps from step to step does not lead on from here. */
    tally[regular ? TALLY_REGULAR_TRIES : TALLY_BESIDE] += 1.0;
    tally[TALLY_BESIDE_LIMITS] += regular ? 0.0 : after[s->near];
    return after[s->trouble] == 0.0 && !(pace[PACE_ACCEPTED] != 0.0 && rounded(i));
}

/* A step on the branch in place of one that could not be judged. In place of an implicit one there is another explicit step,
   whose constraints alone tell whether it is near a singular position: it comes first where they are regular, as where a
   mechanism moves no mass to speak of, and else where that on the branch cannot be judged or has too large an error. */
static void beside_it(Instance *i)
{
    const Scene *s = i->scene;
    const double *after = i->m + s->after, *accepted = i->m + s->pace + PACE_ACCEPTED;
    double kept[PACE];
    int first, lost;
    if (after[s->trouble] == 0.0 || s->beside < 0)
        return;
    memcpy(kept, i->m + s->pace, sizeof kept);
    first = s->regular_step >= 0 && !irregular(i);
    if ((in_place(i, kept, first) && (first || *accepted != 0.0)) || s->regular_step < 0)
        return;
    lost = after[s->trouble] != 0.0;
    in_place(i, kept, !first);
    if (after[s->trouble] != 0.0 && !lost)
        in_place(i, kept, first);
}

/* A try of the other of explicit and implicit steps; they go on where it keeps the tolerance, and 0 where it does not.
   Explicit steps that are so much shorter than a stable method makes them are kept short by stability. */
static int change_over(Instance *i, double left)
{
    const Scene *s = i->scene;
    double *m = i->m, *pace = m + s->pace, kept[PACE];
    const int stiff = pace[PACE_STIFF] != 0.0;
    const double wanted = pace[PACE_DT] * (stiff ? 1.0 : LONGER), patience = fmax(pace[PACE_PATIENCE], PATIENCE);
    if (pace[PACE_SINCE] < patience || pace[PACE_FIXED] != 0.0 || (!stiff && wanted > left))
        return 0;
    memcpy(kept, pace, sizeof kept);
    turn_to(pace, 0);
    pace[PACE_DT] = wanted;
    pace[PACE_LAST] = 0.0;
    run(i, stiff ? s->method_step : s->stiff_step);
    m[s->tally + (stiff ? TALLY_TRIES : TALLY_STIFF_TRIES)] += 1.0;
    if (m[s->after + s->trouble] == 0.0 && pace[PACE_ACCEPTED] != 0.0) {
        pace[PACE_STIFF] = !stiff;
        pace[PACE_SINCE] = pace[PACE_PATIENCE] = 0.0;
        return 1;
    }
    memcpy(pace, kept, sizeof kept);
    pace[PACE_SINCE] = 0.0;
    pace[PACE_PATIENCE] = fmin(2.0 * patience, MOST_PATIENCE);
    return 0;
}

/* A try of a short step, of the method of the scene where that is not possible. By few multiplier iterations; by more
   where they were not enough, or the error of an explicit step is too large, as what they leave is part of it; on the
   branch near a singular position. */
static void try_step(Instance *i)
{
    const Scene *s = i->scene;
    double *m = i->m, *after = m + s->after, *pace = m + s->pace, *tally = m + s->tally;
    const double left = pace[PACE_END] - m[s->z + s->time];
    double dt, before, refused;
    int careful;
    if (s->stiff_step >= 0 && change_over(i, left))
        return;
    turn_to(pace, pace[PACE_STIFF] == 0.0 && short_ones(i, left));
    if (pace[PACE_SHORT] != 0.0) {
        if (try_short(i))
            return;
        turn_to(pace, 0);
    }
    if (pace[PACE_STIFF] != 0.0) {
        run(i, s->stiff_step);
        tally[TALLY_STIFF_TRIES] += 1.0;
        beside_it(i);
        return;
    }
    dt = pace[PACE_DT], before = pace[PACE_BEFORE], refused = pace[PACE_REFUSED];
    careful = s->method_careful >= 0 && (pace[PACE_CAREFUL] > 0.0 || (pace[PACE_CAREFUL] <= -UNSEEN && !s->implicit));
    if (careful)
        pace[PACE_CAREFUL] = fmax(pace[PACE_CAREFUL], 1.0) - 1.0;
    else {
        pace[PACE_CAREFUL] -= 1.0;
        run(i, s->method_step);
        tally[TALLY_TRIES] += 1.0;
        if (s->method_careful >= 0 && (after[s->trouble] != 0.0 || (pace[PACE_ACCEPTED] == 0.0 && !s->implicit))
            && !(after[s->near] != 0.0 && irregular(i))) {
            careful = 1;
            pace[PACE_CAREFUL] = STAYS_CAREFUL;
            pace[PACE_DT] = dt;
            pace[PACE_BEFORE] = before;
            pace[PACE_REFUSED] = refused;
        }
    }
    if (careful) {
        run(i, s->method_careful);
        tally[TALLY_TRIES] += 1.0;
        tally[TALLY_CAREFUL_TRIES] += 1.0;
        if (after[s->trouble] == 0.0 && pace[PACE_FLOOR] > SEEN_FLOOR)
            pace[PACE_CAREFUL] = STAYS_CAREFUL;
    }
    beside_it(i);
}

/* The shortest step that a method with error control may make here. */
static double shortest(const Instance *i)
{
    return fmax(GIVEN_UP, LEAST_DIGITS * DBL_EPSILON * fabs(i->m[i->scene->z + i->scene->time]));
}

/* Steps go on from a jump that was crossed. */
static void crossed(Instance *i, double least)
{
    double *pace = i->m + i->scene->pace;
    i->crossings++;
    pace[PACE_DT] = LONGER * least;
    pace[PACE_BEFORE] = LEAST_BEFORE;
    pace[PACE_REFUSED] = pace[PACE_LAST] = 0.0;
}

/* Whether a step is as short as it may be and yet has too large an error, as where something jumps by the motion: it is
   taken, as the error is that jump over no time. Where this happens again and again there is another cause. */
static int crosses(Instance *i)
{
    const Scene *s = i->scene;
    double *m = i->m, *pace = m + s->pace;
    const double least = shortest(i), tried = m[s->after + s->time] - m[s->z + s->time];
    if (pace[PACE_FIXED] != 0.0 || !(pace[PACE_DT] < least) || !isfinite(m[s->after + s->change]))
        return 0;
    if (tried > 2.0 * least) {
        pace[PACE_DT] = least;
        return 0;
    }
    if (i->crossings == CROSSINGS)
        return 0;
    crossed(i, least);
    return 1;
}

/* The same where an implicit step does not even converge, however short it is: RK4 makes it. */
static int crosses_by_rk4(Instance *i)
{
    const double least = shortest(i), left = i->m[i->scene->pace + PACE_END] - i->m[i->scene->z + i->scene->time];
    if (i->crossings == CROSSINGS || i->m[i->scene->pace + PACE_FIXED] != 0.0 || advance(i, 1, fmin(least, left)) != 1)
        return 0;
    crossed(i, least);
    return 1;
}

/* Steps by the method of the scene up to an end, or so many tries; 0 where one could not be judged. */
int cover(Instance *i, double end, long tries)
{
    const Scene *s = i->scene;
    double *m = i->m, *after = m + s->after, *pace = m + s->pace, *tally = m + s->tally;
    double judged = 0.0; /* step of the first try that could not be judged, since one that could */
    double until = -INFINITY;
    int stuck = 0;
    pace[PACE_END] = end;
    for (; m[s->z + s->time] < end && tries != 0 && i->left > 0; tries--, i->left--) {
        if (ended(i))
            return 0;
        try_step(i);
        if (after[s->trouble] != 0.0 && judged == 0.0)
            judged = pace[PACE_DT];
        if (after[s->trouble] != 0.0) {
            const double wanted = fmin(pace[PACE_DT], end - m[s->z + s->time]), shorter = SHORTENED * wanted;
            if (after[s->near] != 0.0 && m[s->z + s->time] > until) {
                until = m[s->z + s->time] + wanted;
                stuck = 0;
            }
            stuck += after[s->near] != 0.0;
            if (shorter < GIVEN_UP && after[s->near] == 0.0 && crosses_by_rk4(i))
                continue;
            if (pace[PACE_FIXED] != 0.0 || shorter < GIVEN_UP || stuck == STUCK) {
                /* Near a singular position it is not the length of the step that is wrong. */
                pace[PACE_DT] = after[s->near] != 0.0 ? judged : fmin(pace[PACE_DT], shorter);
                return 0;
            }
            pace[PACE_DT] = shorter;
            pace[PACE_REFUSED] = 1.0;
            tally[TALLY_REFUSED] += 1.0;
            continue;
        }
        judged = 0.0;
        /* The tolerance of a step is a share of that of the run. */
        if (pace[PACE_ACCEPTED] != 0.0 && rounded(i))
            warn(i, WARNED_OF_ROUND_OFF,
                "%s, t = %.6g s: round-off leaves an error of some %.1g; solver.relative_tolerance %g cannot be had here, "
                "and the motion goes on at that",
                s->name, m[s->z + s->time], i->values[s->relative_tolerance] * pace[PACE_FLOOR] * s->share / NOISE,
                i->values[s->relative_tolerance]);
        if (pace[PACE_ACCEPTED] != 0.0 && m[s->after + s->time] - m[s->z + s->time] > AWAY_FROM_IT * shortest(i))
            i->crossings = 0;
        if (pace[PACE_ACCEPTED] != 0.0 || crosses(i)) {
            /* Steps that are refused regain nothing: short ones and those of the method would take turns for ever. */
            if (pace[PACE_OTHER_DT] < end - m[s->z + s->time])
                pace[PACE_OTHER_DT] *= REGAINED;
            pace[PACE_SINCE] += 1.0;
            arrive(i);
        }
        tally[pace[PACE_ACCEPTED] != 0.0 ? TALLY_COVERED : TALLY_REFUSED] += 1.0;
    }
    return 1;
}

/* A communication step by RK4 in one go; 0, and nothing has changed, where that is not possible. `made` is then the
   internal steps before the one that was not, -1 where none was tried. */
int communicate(Instance *i, double start, double h, long *made)
{
    const Scene *s = i->scene;
    double *m = i->m, *z = m + s->z, ratio;
    double counted[TALLY];
    const size_t state = state_length(s) * sizeof *m, past = (size_t)s->past_size * sizeof *m;
    const Mark begun = tape_mark(i);
    long steps;
    *made = -1;
    ratio = h / m[s->control + CONTROL_STEP_SIZE] * (1 - 1e-12);
    if (!(ratio < MOST_STEPS))
        return 0;
    steps = ratio <= 1.0 ? 1 : (long)ceil(ratio);
    memcpy(m + s->begin, z, state);
    memcpy(counted, m + s->tally, TALLY * sizeof *m);
    memcpy(i->past_before, m + s->past, past);
    at_time(i, start);
    if (s->reach >= 0)
        run(i, s->reach);
    *made = advance(i, steps, h / (double)steps);
    if (*made != steps) {
        tape_cut(i, begun);
        memcpy(z, m + s->begin, state);
        count_turns(i);
        memcpy(m + s->tally, counted, TALLY * sizeof *m);
        memcpy(m + s->past, i->past_before, past);
        return 0;
    }
    at_time(i, start + h);
    return 1;
}

/* What can be read at this instant by few iterations, as the first of a quick step; 0 where more are needed. */
static int read_at_once(Instance *i)
{
    const Scene *s = i->scene;
    const double *control = i->m + s->control;
    if (s->instant_quick < 0 || control[CONTROL_TIER] != 0.0 || (control[CONTROL_METHOD] != 0.0 && s->short_onward < 0))
        return 0;
    run(i, s->instant_quick);
    memcpy(i->read_at, i->m + s->z, 2 * (size_t)s->n * sizeof *i->m);
    memcpy(i->read_at + 2 * s->n, i->m + s->u, (size_t)s->inputs * sizeof *i->m);
    i->onward = s->onward >= 0 || s->short_onward >= 0;
    return verdict(i, SEEN_TROUBLE) == 0.0 && verdict(i, SEEN_NEAR) == 0.0;
}

/* What can be read at this instant; 0 where the unrolled loops were not enough. */
int read_quickly(Instance *i)
{
    const Scene *s = i->scene;
    i->onward = 0;
    if (read_at_once(i)) {
        i->counts[QUICK_READS] += 1.0;
        return 1;
    }
    run(i, s->instant);
    if (verdict(i, SEEN_NEAR) != 0.0 && s->limit >= 0)
        run(i, s->limit);
    return verdict(i, SEEN_TROUBLE) == 0.0;
}
