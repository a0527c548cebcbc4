/* Model Exchange: an importer integrates coordinates, their rates and the states of first-order equations.

   Errors of the importer's steps violate the constraints. Rates and outputs are evaluated at the importer's states
   projected onto the constraints (10), and a term in the rates leads the states back to the constraints. So these hold
   in every output, and errors across them decay. An event corrects states after a step only if they are far from the
   constraints, as events restart the importer's method (docs/howto/exchange.md has the measurement). */

#include "exchange.h"

#include "breaks.h"
#include "equations.h"
#include "friction.h"
#include "friction_events.h"
#include "instance.h"
#include "interpret.h"
#include "jumps.h"
#include "layout.h"
#include "message.h"
#include "outputs.h"
#include "projection.h"
#include "record.h"
#include "scene.h"
#include "scene_sizes.h"
#include "settings.h"
#include "state.h"
#include "topology.h"

/* Distance of states from the constraints after a step, in units of their nominal values, above which an event corrects
   them. Steps of first-order methods exceed it, steps with error control do not. */
#define FAR_AWAY 1e-3

/* Length of an interval that is searched for the next event, in internal steps, and the number of intervals after which
   a time event makes the importer ask again. */
#define WINDOW 50
#define MOST_WINDOWS 1000

/* Copy the importer's states into the state of the instance, or back. */
static void move_states(Instance *i, int back)
{
    const Scene *s = i->scene;
    const size_t n = (size_t)scene_coordinates(s);
    double *z = instance_field(i, s->z), *own[] = {z, z + s->n, instance_states(i)}, *other = i->exchange;
    const size_t counts[] = {n, n, (size_t)scene_states(s)};
    for (int k = 0; k < 3; other += counts[k], k++) {
        double *to = back ? other : own[k], *from = back ? own[k] : other;
        memcpy(to, from, counts[k] * sizeof *to);
        tape_copy(i, to, from, counts[k]);
    }
}

/* Project the state onto the constraints. */
static Outcome close_constraints(Instance *i)
{
    const Scene *s = i->scene;
    double *q = instance_field(i, s->z), *v = q + s->n;
    if (!s->l || !settings_project(i))
        return DONE;
    if (i->tape) { /* At least one correction is recorded, so that derivatives are along the constraints. */
        const size_t arena = arena_mark(i), n = (size_t)s->n;
        double *next = arena_alloc(i, n), pivot, left[2];
        const double *x[] = {q, instance_field(i, s->p), instance_field(i, s->k)},
                     *at[] = {q, v, instance_field(i, s->p), instance_field(i, s->k)};
        double *y[] = {next}, *settled[] = {next, &pivot, left};
        function_call_recorded(i, s->place, x, y);
        memcpy(q, next, n * sizeof *q);
        tape_copy(i, q, next, n);
        function_call_recorded(i, s->settle, at, settled);
        memcpy(v, next, n * sizeof *v);
        tape_copy(i, v, next, n);
        arena_release(i, arena);
    }
    return projection_apply(i, q, v);
}

/* Compute the rates of the states after an evaluation of the outputs. */
static void find_rates(Instance *i)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), inputs = (size_t)s->inputs, states = (size_t)scene_states(s),
                 n = (size_t)scene_coordinates(s);
    double *rates = i->exchange + scene_exchanged(s), *q = instance_field(i, s->z), *v = q + s->n,
           *a = i->workspace + s->exchange;
    const double back = i->flags.mode && s->l && settings_project(i) ? s->fading : 0.0,
                 by[] = {1.0, back, -back};
    for (size_t k = 0; k < 2 * n; k++) {
        const double *at = k < n ? q + k : v + (k - n), *rate = k < n ? v + k : a + (k - n),
                     *from[] = {rate, at, i->exchange + k};
        rates[k] = *rate + back * (*at - i->exchange[k]);
        tape_sum(i, rates + k, back > 0.0 ? 3 : 1, from, by);
    }
    if (states) {
        double *u = arena_alloc(i, inputs + states), *y[] = {rates + 2 * n};
        const double *x[] = {q, v, u, instance_field(i, s->p), instance_time(i)};
        memcpy(u, i->m + s->u, inputs * sizeof *u);
        tape_copy(i, u, i->m + s->u, inputs);
        memcpy(u + inputs, instance_states(i), states * sizeof *u);
        tape_copy(i, u + inputs, instance_states(i), states);
        function_call_recorded(i, s->state_rates, x, y);
    }
    arena_release(i, arena);
}

Outcome exchange_read(Instance *i)
{
    Outcome outcome = DONE;
    if (i->flags.mode && i->flags.known)
        return DONE;
    arena_reset(i);
    i->flags.known = 0;
    if (i->flags.mode) {
        move_states(i, 0);
        settings_upload_arguments(i);
        outcome = close_constraints(i);
    }
    if (outcome == DONE)
        outcome = instance_read(i);
    if (outcome != DONE)
        return outcome;
    find_rates(i);
    if (!i->flags.mode)
        move_states(i, 1);
    return DONE;
}

static double *times_of(const Instance *i)
{
    return i->exchange + scene_exchange_variables(i->scene);
}

Outcome exchange_begin(Instance *i)
{
    double *times = times_of(i);
    Outcome outcome;
    i->flags.mode = 0;
    outcome = exchange_read(i);
    i->flags.mode = AT_EVENT;
    times[FROM] = *instance_time(i);
    times[UNTIL] = times[BEHIND] = INFINITY;
    return outcome;
}

/* An importer may evaluate beyond the next event before it handles it; the laws before the event apply until then. */
void exchange_set_time(Instance *i, double time)
{
    const double *times = times_of(i), within = fmin(fmax(time, times[FROM]), times[UNTIL]);
    if (within != *instance_time(i))
        i->flags.known = 0;
    instance_set_time(i, within);
}

void exchange_set_states(Instance *i, const double *states)
{
    memcpy(i->exchange, states, (size_t)scene_exchanged(i->scene) * sizeof *states);
    i->flags.known = 0;
}

/* The nominal length is the mechanism's, the nominal angle 1 rad; nominal rates are these values per second. */
void exchange_nominals(const Instance *i, double *found)
{
    const Scene *s = i->scene;
    const int n = scene_coordinates(s), count = scene_exchanged(s);
    for (int k = 0; k < count; k++)
        found[k] = k >= 2 * n ? s->nominals[k - 2 * n] : coordinate_is_length(s, k % n) ? *i->length : 1.0;
}

Outcome exchange_accept(Instance *i, int *far)
{
    const Scene *s = i->scene;
    const size_t n = (size_t)scene_coordinates(s);
    const double *z = instance_field(i, s->z);
    double *nominals, worst = 0.0;
    size_t which = 0;
    const Outcome outcome = exchange_read(i);
    *far = 0;
    if (outcome != DONE)
        return outcome;
    settings_follow_turns(i);
    arena_reset(i);
    nominals = arena_alloc(i, (size_t)scene_exchanged(s));
    exchange_nominals(i, nominals);
    for (size_t k = 0; k < 2 * n; k++) {
        const double off = fabs(i->exchange[k] - z[k < n ? k : (size_t)s->n + k - n]) / nominals[k];
        if (off > worst) {
            worst = off;
            which = k % n;
        }
    }
    *far = worst > FAR_AWAY;
    if (*far)
        instance_warn(i, WARNED_OF_IMPORTER,
            "%s, t = %.6g s: a step of the importer left %s or its rate %.1e of its nominal value off the constraints, "
            "more than %.0e; let it take shorter steps, or use its solver with error control",
            s->name, *instance_time(i), s->coordinates[which].name, worst, FAR_AWAY);
    arena_reset(i);
    return DONE;
}

/* Find the next time at which forces or laws of time jump or bend, or the end of the search if there is none. */
static Outcome find_next_time(Instance *i)
{
    const Scene *s = i->scene;
    double *times = times_of(i), begin = *instance_time(i), end;
    const double window = WINDOW * i->values[s->step_size];
    Outcome outcome = DONE;
    times[UNTIL] = times[BEHIND] = INFINITY;
    if (!s->break_count && !s->leap_count)
        return DONE;
    for (int pass = 0; pass < (s->leap_count ? 1 : MOST_WINDOWS) && begin < i->stop; pass++, begin = end) {
        end = begin + window;
        outcome = breaks_found(i, begin, end);
        for (int k = 0; k < i->broken && outcome == DONE; k++)
            if (i->breaks[2 * k] <= times[FROM]) {
                times[FROM] = fmax(times[FROM], i->breaks[2 * k + 1]);
            } else {
                times[UNTIL] = i->breaks[2 * k];
                times[BEHIND] = end = i->breaks[2 * k + 1];
                i->broken = k + 1;
            }
        if (outcome == DONE)
            outcome = laws_checked(i, end);
        if (outcome != DONE || times[UNTIL] < INFINITY)
            return outcome;
    }
    if (begin < i->stop)
        times[UNTIL] = times[BEHIND] = begin;
    return DONE;
}

/* Let joints whose event indicators have reached zero stick or slide, with a margin: an importer that meets an
   indicator of exactly zero sees no further change of its sign. */
static Outcome change_friction(Instance *i)
{
    const int count = i->scene->frictions;
    const size_t arena = arena_mark(i);
    double *distances = arena_alloc(i, (size_t)count);
    unsigned char *meets = (unsigned char *)arena_alloc(i, (size_t)count);
    int any = 0;
    Outcome outcome;
    friction_distances(i, distances);
    for (int k = 0; k < count; k++) {
        any |= distances[k] <= REST;
        meets[k] = fabs(*friction_slip(i, k)) == 1.0 && distances[k] <= REST;
    }
    outcome = any ? friction_event(i, meets) : friction_checked(i);
    arena_release(i, arena);
    return outcome;
}

Outcome exchange_event(Instance *i, double *next)
{
    const Scene *s = i->scene;
    double *times = times_of(i);
    Outcome outcome;
    if (*instance_time(i) >= times[UNTIL]) {
        times[FROM] = times[BEHIND];
        times[UNTIL] = INFINITY;
        exchange_set_time(i, times[FROM]);
    }
    outcome = exchange_read(i);
    if (outcome != DONE)
        return outcome;
    arena_reset(i);
    instance_remember(i);
    settings_upload_arguments(i);
    if (i->flags.pending)
        outcome = topology_take_effect(i);
    else if (s->frictions)
        outcome = change_friction(i);
    if (outcome == DONE)
        outcome = find_next_time(i);
    arena_reset(i);
    if (outcome != DONE) {
        instance_go_back(i);
        memcpy(i->requested, i->active, (size_t)s->switches * sizeof *i->active);
        i->flags.pending = 0;
        return outcome;
    }
    *next = times[UNTIL];
    move_states(i, 1);
    i->flags.known = 0;
    return exchange_read(i);
}

/* A joint that begins to slide has no rate yet; an offset by the rate that counts as rest keeps its indicator
   positive. */
Outcome exchange_indicate(Instance *i)
{
    const Scene *s = i->scene;
    double *found = i->exchange + 2 * scene_exchanged(s);
    const Outcome outcome = exchange_read(i);
    if (outcome != DONE || !s->frictions)
        return outcome;
    arena_reset(i);
    friction_distances(i, found);
    for (int k = 0; k < s->frictions; k++)
        found[k] += fabs(*friction_slip(i, k)) == 1.0 ? REST : 0.0;
    return DONE;
}
