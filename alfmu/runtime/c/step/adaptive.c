#include "adaptive.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "diagnosis.h"
#include "fixed.h"
#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "message.h"
#include "scene.h"
#include "way.h"

/* Shortest step, in units of the last digit of the time. */
#define LEAST_DIGITS 16

/* Most jumps that steps of the least length cross in sequence, which a step AWAY_FROM_IT times as long ends. */
#define CROSSINGS 4
#define AWAY_FROM_IT 1e3

/* Number of steps over which their mean length is judged: some 0.15 s of a plane loop. */
#define CRAWL 1000

/* Return whether constraints that are usually independent may depend on each other at this position. */
static int is_irregular(Instance *i)
{
    const Scene *s = i->scene;
    double found = 1.0;
    const double *x[] = {i->m + s->z, i->m + s->p, i->m + s->k};
    double *y[] = {&found};
    if (s->irregular >= 0)
        function_call(i, s->irregular, x, y);
    return found != 0.0;
}

/* Exchange the step-control numbers of short steps and of the integrator's own steps. */
static void switch_step_kind(double *pace, int kind)
{
    double *own = pace + PACE_DT, *other = pace + PACE_OTHER_DT;
    if (kind == (pace[PACE_SHORT] != 0.0))
        return;
    for (int k = 0; k < 3; k++) {
        const double kept = own[k];
        own[k] = other[k];
        other[k] = kept;
    }
    if (own[0] == 0.0) { /* No short step has been tried yet. */
        own[0] = other[0];
        own[1] = LEAST_BEFORE;
    }
    pace[PACE_SHORT] = kind;
    pace[PACE_LAST] = 0.0; /* The data that the integrator keeps between steps are invalid here. */
}

/* Return whether short steps reach the end with clearly fewer evaluations than the integrator's own steps. Short
   steps are traced for penalties scaled with the masses and for all constraints in force. */
static int short_steps_serve(const Instance *i, double left)
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

/* Try a short step, on the branch near a singular position. Return 0 if its error cannot be judged, or if it is
   rejected there, where limits are less exact for short steps. */
static int try_short_step(Instance *i)
{
    const Scene *s = i->scene;
    double *m = i->m, *after = m + s->after, *pace = m + s->pace, *tally = m + s->tally;
    double kept[PACE];
    const int onward = s->reuses && step_can_reuse(i);
    int near = onward && s->short_beside >= 0 && step_reuse_is_near(i);
    tally[TALLY_SHORT_TRIES] += 1.0;
    if (near)
        i->shared += s->short_cost; /* No short step is made here, but the tally counts its evaluations. */
    else {
        i->workspace[s->onward] = onward;
        program_run(i, s->short_step);
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
    way_update(i);
    program_run(i, s->short_beside);
    tally[TALLY_SHORT_BESIDE] += 1.0;
    tally[TALLY_SHORT_LIMITS] += after[s->near];
    if (after[s->trouble] == 0.0 && pace[PACE_ACCEPTED] != 0.0)
        return 1;
    memcpy(pace, kept, sizeof kept);
    return 0;
}

/* Error of a run, over the third power of the round-off of projections along the motion: it was 0.03 to 0.04 for
   slider-cranks whose crank of 1 mm and of 0.3 mm, in joint coordinates, turns a rod of 0.9 m. */
#define DISPLACED 0.1

/* Return the error that projections cause by round-off of penalties, which displaces a motion that only small masses
   hold: as a short crank does whose angle and that of its long rod are coordinates. No step sees it. */
static double error_of_projections(const Instance *i)
{
    const double share = DBL_EPSILON / *i->least_margin;
    return *i->freedom > 0.0 && share < 1.0 ? DISPLACED * share * share * share : 0.0;
}

/* Return whether the error estimate of a step is at the level of round-off. */
static int error_is_round_off(const Instance *i)
{
    return i->m[i->scene->pace + PACE_FLOOR] * i->scene->share > NOISE;
}

/* Try an explicit step in place of one of the integrator, from the same step-control numbers. Return whether its error
   can be judged; not if only round-off makes the error acceptable. */
static int try_explicit_step(Instance *i, const double *kept, int regular)
{
    const Scene *s = i->scene;
    const double *after = i->m + s->after;
    double *pace = i->m + s->pace, *tally = i->m + s->tally;
    memcpy(pace, kept, PACE * sizeof *pace);
    if (!regular)
        way_update(i);
    program_run(i, regular ? s->regular_step : s->beside);
    pace[PACE_LAST] = 0.0; /* The data that the integrator keeps between steps are invalid here. */
    tally[regular ? TALLY_REGULAR_TRIES : TALLY_BESIDE] += 1.0;
    tally[TALLY_BESIDE_LIMITS] += regular ? 0.0 : after[s->near];
    return after[s->trouble] == 0.0 && !(pace[PACE_ACCEPTED] != 0.0 && error_is_round_off(i));
}

/* Try a step on the branch in place of a step that could not be judged. An implicit step is replaced by another
   explicit step, because only its constraints tell whether it is near a singular position. If the constraints are
   regular here, the explicit step comes first; otherwise it follows if the step on the branch cannot be judged or has
   too large an error. */
static void try_branch_step(Instance *i)
{
    const Scene *s = i->scene;
    const double *after = i->m + s->after, *accepted = i->m + s->pace + PACE_ACCEPTED;
    double kept[PACE];
    int first, lost;
    if (after[s->trouble] == 0.0 || s->beside < 0)
        return;
    memcpy(kept, i->m + s->pace, sizeof kept);
    first = s->regular_step >= 0 && !is_irregular(i);
    if ((try_explicit_step(i, kept, first) && (first || *accepted != 0.0)) || s->regular_step < 0)
        return;
    lost = after[s->trouble] != 0.0;
    try_explicit_step(i, kept, !first);
    if (after[s->trouble] != 0.0 && !lost)
        try_explicit_step(i, kept, first);
}

/* Try the other kind of step (explicit or implicit). Return 1 and keep that kind if it meets the tolerance, else 0.
   Explicit steps that are much shorter than those of a stable integrator are limited by stability. */
static int try_other_method(Instance *i, double left)
{
    const Scene *s = i->scene;
    double *m = i->m, *pace = m + s->pace, kept[PACE];
    const int stiff = pace[PACE_STIFF] != 0.0;
    const double length = pace[PACE_DT] * (stiff ? 1.0 : LONGER), patience = fmax(pace[PACE_PATIENCE], PATIENCE);
    if (pace[PACE_SINCE] < patience || pace[PACE_FIXED] != 0.0 || (!stiff && length > left))
        return 0;
    memcpy(kept, pace, sizeof kept);
    switch_step_kind(pace, 0);
    pace[PACE_DT] = length;
    pace[PACE_LAST] = 0.0;
    program_run(i, stiff ? s->method_step : s->stiff_step);
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

/* Try a short step, or a step of the integrator if a short one is impossible. The first try takes few multiplier
   iterations. The second takes more, if few were not enough or the error of an explicit step is too large, because
   the remainder of the iteration is part of the error. Near a singular position the step follows the branch. */
static void try_any_step(Instance *i)
{
    const Scene *s = i->scene;
    double *m = i->m, *after = m + s->after, *pace = m + s->pace, *tally = m + s->tally;
    const double left = pace[PACE_END] - m[s->z + s->time];
    double dt, before, refused;
    int careful;
    if (s->stiff_step >= 0 && try_other_method(i, left))
        return;
    switch_step_kind(pace, pace[PACE_STIFF] == 0.0 && short_steps_serve(i, left));
    if (pace[PACE_SHORT] != 0.0) {
        if (try_short_step(i))
            return;
        switch_step_kind(pace, 0);
    }
    if (pace[PACE_STIFF] != 0.0) {
        program_run(i, s->stiff_step);
        tally[TALLY_STIFF_TRIES] += 1.0;
        try_branch_step(i);
        return;
    }
    dt = pace[PACE_DT], before = pace[PACE_BEFORE], refused = pace[PACE_REFUSED];
    careful = s->method_careful >= 0 && (pace[PACE_CAREFUL] > 0.0 || (pace[PACE_CAREFUL] <= -UNSEEN && !s->implicit));
    if (careful)
        pace[PACE_CAREFUL] = fmax(pace[PACE_CAREFUL], 1.0) - 1.0;
    else {
        pace[PACE_CAREFUL] -= 1.0;
        program_run(i, s->method_step);
        tally[TALLY_TRIES] += 1.0;
        if (s->method_careful >= 0 && (after[s->trouble] != 0.0 || (pace[PACE_ACCEPTED] == 0.0 && !s->implicit))
            && !(after[s->near] != 0.0 && is_irregular(i))) {
            careful = 1;
            pace[PACE_CAREFUL] = STAYS_CAREFUL;
            pace[PACE_DT] = dt;
            pace[PACE_BEFORE] = before;
            pace[PACE_REFUSED] = refused;
        }
    }
    if (careful) {
        program_run(i, s->method_careful);
        tally[TALLY_TRIES] += 1.0;
        tally[TALLY_CAREFUL_TRIES] += 1.0;
        if (after[s->trouble] == 0.0 && pace[PACE_FLOOR] > SEEN_FLOOR)
            pace[PACE_CAREFUL] = STAYS_CAREFUL;
    }
    try_branch_step(i);
}

/* Lengthen the step that is assumed for the unused kind after a step of the other. As long as the integrator's own
   steps have not been tried, they are assumed to be as long as the short ones: the first step is a guess. */
static void lengthen_other_kind(Instance *i, double left)
{
    double *pace = i->m + i->scene->pace;
    if (pace[PACE_OTHER_DT] < left)
        pace[PACE_OTHER_DT] *= REGAINED;
    if (pace[PACE_SHORT] != 0.0 && i->m[i->scene->tally + TALLY_TRIES] == 0.0)
        pace[PACE_OTHER_DT] = fmax(pace[PACE_OTHER_DT], pace[PACE_DT]);
}

/* Return the shortest step that an integrator with error control may take here. */
static double shortest_step(const Instance *i)
{
    return fmax(GIVEN_UP, LEAST_DIGITS * DBL_EPSILON * fabs(i->m[i->scene->z + i->scene->time]));
}

/* Restart step control after a jump. */
static void note_crossing(Instance *i, double least)
{
    double *pace = i->m + i->scene->pace;
    i->crossings++;
    pace[PACE_DT] = LONGER * least;
    pace[PACE_BEFORE] = LEAST_BEFORE;
    pace[PACE_REFUSED] = pace[PACE_LAST] = 0.0;
}

/* Accept a step of the least length although its error is too large: at a jump that depends on the motion, the error is
   the jump itself, over almost no time. Return 0 if this happens repeatedly, as the cause is then no jump. */
static int cross_jump(Instance *i)
{
    const Scene *s = i->scene;
    double *m = i->m, *pace = m + s->pace;
    const double least = shortest_step(i), tried = m[s->after + s->time] - m[s->z + s->time];
    if (pace[PACE_FIXED] != 0.0 || !(pace[PACE_DT] < least) || !isfinite(m[s->after + s->change]))
        return 0;
    if (tried > 2.0 * least) {
        pace[PACE_DT] = least;
        return 0;
    }
    if (i->crossings == CROSSINGS)
        return 0;
    note_crossing(i, least);
    return 1;
}

/* Cross a jump by RK4 if even the shortest implicit step does not converge. */
static int cross_jump_by_rk4(Instance *i)
{
    const double least = shortest_step(i), left = i->m[i->scene->pace + PACE_END] - i->m[i->scene->z + i->scene->time];
    if (i->crossings == CROSSINGS || i->m[i->scene->pace + PACE_FIXED] != 0.0
        || step_fixed(i, 1, fmin(least, left)) != 1)
        return 0;
    note_crossing(i, least);
    return 1;
}

/* Return whether steps of the mean length of the last CRAWL, taken since a time, would reach the work limit before
   `end`, because laws lead to a dead position: steps become ever shorter there. */
static int crawls_to_dead_position(Instance *i, double since, double end)
{
    const double t = i->m[i->scene->z + i->scene->time];
    return (t - since) * (double)i->left < (end - t) * CRAWL && diagnose_laws(i, end) != DONE;
}

/* Take steps of the integrator up to `end`, at most `tries` attempts. Return 0 if a step could not be judged. */
int step_adaptive(Instance *i, double end, long tries)
{
    const Scene *s = i->scene;
    double *m = i->m, *after = m + s->after, *pace = m + s->pace, *tally = m + s->tally;
    const double relative = i->values[s->relative_tolerance];
    double judged = 0.0; /* length of the first step that could not be judged since the last judged one */
    double until = -INFINITY, window = 0.0, since = m[s->z + s->time];
    int stuck = 0, made = 0;
    pace[PACE_END] = end;
    for (; m[s->z + s->time] < end && tries != 0 && i->left > 0; tries--, i->left--) {
        if (run_is_ended(i))
            return 0;
        if (++made % CRAWL == 0) {
            if (crawls_to_dead_position(i, since, end)) {
                i->left = 0;
                return 0;
            }
            since = m[s->z + s->time];
        }
        try_any_step(i);
        if (after[s->trouble] != 0.0 && judged == 0.0)
            judged = pace[PACE_DT];
        if (after[s->trouble] != 0.0) {
            const double tried = fmin(pace[PACE_DT], end - m[s->z + s->time]), shorter = SHORTENED * tried;
            if (after[s->near] != 0.0 && m[s->z + s->time] > until) {
                /* Steps that shrink towards a position leave each window of their own length. */
                window = fmax(tried, window / 2);
                until = m[s->z + s->time] + window;
                stuck = 0;
            }
            stuck += after[s->near] != 0.0;
            if (shorter < GIVEN_UP && after[s->near] == 0.0 && cross_jump_by_rk4(i))
                continue;
            if (pace[PACE_FIXED] != 0.0 || shorter < GIVEN_UP || stuck == STUCK) {
                /* Near a singular position a shorter step does not help. */
                pace[PACE_DT] = after[s->near] != 0.0 ? judged : fmin(pace[PACE_DT], shorter);
                return 0;
            }
            pace[PACE_DT] = shorter;
            pace[PACE_REFUSED] = 1.0;
            tally[TALLY_REFUSED] += 1.0;
            continue;
        }
        judged = 0.0;
        /* The tolerance of a step is a share of the tolerance of the run. */
        if (pace[PACE_ACCEPTED] != 0.0 && (error_is_round_off(i) || error_of_projections(i) > relative))
            instance_warn(i, WARNED_OF_ROUND_OFF,
                "%s, t = %.6g s: round-off causes an error of about %.1g, so that solver.relative_tolerance %g cannot "
                "be met here; the run continues with that error",
                s->name, m[s->z + s->time],
                fmax(relative * pace[PACE_FLOOR] * s->share / NOISE, error_of_projections(i)), relative);
        if (pace[PACE_ACCEPTED] != 0.0 && m[s->after + s->time] - m[s->z + s->time] > AWAY_FROM_IT * shortest_step(i))
            i->crossings = 0;
        if (pace[PACE_ACCEPTED] != 0.0 || cross_jump(i)) {
            /* A rejected step does not lengthen the next one; otherwise short steps and steps of the integrator
               would alternate for ever. */
            lengthen_other_kind(i, end - m[s->z + s->time]);
            pace[PACE_SINCE] += 1.0;
            step_commit(i);
        }
        tally[pace[PACE_ACCEPTED] != 0.0 ? TALLY_COVERED : TALLY_REFUSED] += 1.0;
    }
    return 1;
}
