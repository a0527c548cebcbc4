#include "begin.h"

#include "agreement.h"
#include "assemble.h"
#include "balance.h"
#include "diagnosis.h"
#include "driving_inputs.h"
#include "equations.h"
#include "friction.h"
#include "instance.h"
#include "interpret.h"
#include "jumps.h"
#include "layout.h"
#include "linear.h"
#include "masses.h"
#include "message.h"
#include "peaks.h"
#include "penalties.h"
#include "projection.h"
#include "record.h"
#include "scene.h"
#include "scene_sizes.h"
#include "settings.h"
#include "topology.h"
#include "way.h"

/* Distance of a mechanism from the origin over the size of its smallest loop from which a warning says that round-off
   of places counts: at 1e4, an angle that passes singular positions is off by 4 times a tolerance of 1e-9, at 1e5 by
   700 times. */
#define OUT_OF_REACH 3e4

static Outcome read_compliances(Instance *i)
{
    const Scene *s = i->scene;
    const int first = s->own + 2 * s->starts;
    int given = 0;
    for (int k = 0; k < s->compliances; k++) {
        i->compliances[k] = i->values[first + k];
        given += i->compliances[k] > 0.0;
    }
    if (!given || given == s->compliances)
        return DONE;
    for (int k = 0;; k++)
        if (i->compliances[k] == 0.0)
            return instance_say(i, REFUSED,
                "%s: %s is 0 and others are not; give each constraint a compliance, or none", s->name,
                s->variables[first + k].name);
}

/* Return DONE if the constraints are as consistent as integrators with error control require. */
static Outcome check_agreed(Instance *i, const unsigned char *held, const double *q, const double *v)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), l = (size_t)s->l;
    double *C = arena_alloc(i, (size_t)s->constraint.entries), *phi = arena_alloc(i, l), *cv = arena_alloc(i, l);
    Outcome outcome;
    constraints_evaluate(i, q, v, NULL, C, phi, cv);
    outcome = agreement_check(i, held, q, NULL, phi);
    if (outcome == DONE && !projection_is_closed(i, cv, C, q, v))
        outcome = agreement_check(i, held, q, v, cv);
    arena_release(i, arena);
    return outcome;
}

/* Set computed angles near their start values. */
static void begin_angles(Instance *i)
{
    const Scene *s = i->scene;
    double *z = instance_field(i, s->z);
    for (int k = 0; k < s->angles; k++) {
        const double *angle = s->angle_starts[k] < 0 ? NULL : i->values + s->own + s->angle_starts[k];
        z[2 * s->n + k] = angle ? *angle : 0.0;
        if (angle)
            tape_copy(i, z + 2 * s->n + k, angle, 1);
    }
}

/* Start the motion at q and v, with all counters at zero. */
static void begin_motion(Instance *i, const double *q, const double *v, double time)
{
    const Scene *s = i->scene;
    double *z = instance_field(i, s->z), kinetic;
    const double *first = i->values + s->own + 2 * s->starts + s->compliances;
    memset(z, 0, scene_state_length(s) * sizeof *z);
    memcpy(z, q, (size_t)s->n * sizeof *q);
    memcpy(z + s->n, v, (size_t)s->n * sizeof *v);
    tape_clearing(i, z, scene_state_length(s));
    tape_copy(i, z, q, (size_t)s->n);
    tape_copy(i, z + s->n, v, (size_t)s->n);
    begin_angles(i);
    memcpy(instance_states(i), first, (size_t)scene_states(s) * sizeof *z);
    tape_copy(i, instance_states(i), first, (size_t)scene_states(s));
    z[s->time] = time;
    memset(i->impulses, 0, (size_t)s->impulses * sizeof *i->impulses);
    memset(i->jacobian, 0, (size_t)s->entries * sizeof *i->jacobian);
    memset(i->peaks, 0, scene_peaks_length(s) * sizeof *i->peaks);
    *i->dissipated = 0.0;
    memset(instance_field(i, s->pace), 0, PACE * sizeof(double));
    instance_field(i, s->pace)[PACE_DT] = FIRST_STEP * i->values[s->step_size];
    instance_field(i, s->pace)[PACE_BEFORE] = LEAST_BEFORE;
    memset(i->counts, 0, COUNTED * sizeof *i->counts);
    memset(instance_field(i, s->tally), 0, TALLY * sizeof(double));
    i->counts[ENERGY_START] = energy_evaluate(i, z + s->n, &kinetic);
    /* The scale of energies is never below the energy of a slow motion. */
    i->counts[ENERGY_SCALE] = fabs(energy_at_speed(i, SLOW_MOTION)) + DBL_MIN;
    i->flags.warned = i->warns = 0;
    i->shared = 0;
}

static Outcome begin_run(Instance *i)
{
    const Scene *s = i->scene;
    const size_t l = (size_t)s->l, n = (size_t)s->n;
    double *q = arena_alloc(i, n), *v = arena_alloc(i, n), *masses = arena_alloc(i, l),
           alpha = i->values[s->penalty], heavy = 0.0;
    int light = -1; /* a constraint whose penalty is below the mass that it holds */
    unsigned char *held = (unsigned char *)arena_alloc(i, l);
    const double time = *instance_time(i);
    Outcome outcome;
    inputs_begin(i, time);
    friction_reset(i);
    begin_angles(i);
    settings_upload_parameters(i);
    for (int k = 0; k < s->switches; k++)
        i->active[k] = i->requested[k] != 0.0 && !s->switched[k].holds;
    settings_in_force(i, i->active, held);
    for (int r = 0; r < s->l; r++)
        held[r] &= !(i->flags.given && i->given[r] == 0.0);
    outcome = start_assemble(i, held, q, v);
    if (outcome == DONE)
        outcome = masses_check(i, q, held);
    if (outcome == DONE)
        outcome = read_compliances(i);
    if (outcome != DONE)
        return outcome;
    penalties_default(i, q, i->full);
    /* The quick step of the kernel is calibrated for the default penalty only. */
    i->flags.scaled = alpha == 0.0 && !i->flags.given;
    for (int r = 0; r < s->l; r++) {
        const double mass = i->full[r] / PENALTY_RATIO;
        i->flags.scaled &= s->weighted || i->full[r] == i->full[0];
        masses[r] = mass;
        i->full[r] = i->flags.given ? i->given[r] : alpha > 0.0 ? alpha : i->full[r];
        if (held[r] && i->full[r] < mass * (1 - 1e-9) && mass > heavy)
            heavy = mass, light = r;
    }
    if (s->l && alpha == 0.0 && !i->flags.given) {
        const double lightest = masses_lightest(i, q, held, masses);
        for (int r = 0; lightest < LIGHTEST && r < s->l; r++)
            i->full[r] *= fmax(lightest / LIGHTEST, LEAST_RATIO / PENALTY_RATIO);
        i->flags.scaled &= lightest >= LIGHTEST;
    }
    for (int r = 0; r < s->l; r++)
        i->penalty[r] = held[r] ? i->full[r] : 0.0;
    settings_set_penalties(i);
    *i->agreed = 0.0;
    if (s->l && settings_project(i))
        outcome = projection_apply(i, q, v);
    if (outcome == DONE)
        outcome = settings_update_rank(i, q, v);
    if (outcome == DONE && s->l && settings_method(i) == 1)
        outcome = check_agreed(i, held, q, v);
    if (outcome != DONE)
        return outcome;
    begin_motion(i, q, v, time);
    if (s->l)
        agreement_warn_of_second_order(i, held, q);
    if (s->l && constraints_reach(i, q) > OUT_OF_REACH)
        instance_warn(i, WARNED_OF_REACH,
            "%s: its points lie up to %.2g m from the origin, %.1g times the size of its smallest loop (%.2g m), so "
            "that round-off of places may exceed solver.relative_tolerance behind singular positions; declare it near "
            "the origin",
            s->name, constraints_reach(i, q) * *i->loop, constraints_reach(i, q), *i->loop);
    if (light >= 0)
        instance_warn(i, WARNED_OF_PENALTY,
            "%s: solver.penalty %g is below the mass %g that %s %s holds, so that multipliers may be wrong; use 0, "
            "which "
            "scales it with the masses",
            s->name, i->full[light], heavy, s->rows[light].name, s->rows[light].direction);
    settings_upload(i);
    way_begin(i, held, q, v);
    settings_follow_turns(i); /* The first step may lead past half a turn. */
    for (int k = 0; k < s->switches; k++)
        if (i->requested[k] != i->active[k])
            return topology_take_effect(i);
    return friction_begin(i);
}

Outcome instance_initialize(Instance *i)
{
    const Scene *s = i->scene;
    Outcome outcome;
    if (s->entries && diagnose_derivatives(i) != DONE)
        return REFUSED;
    if (settings_method(i) && !settings_all_serve(i))
        return instance_say(i, REFUSED,
            "%s: solver.method %s needs solver.formulation residual with projections here; choose it, or export with "
            "solver.method rk4",
            s->name, settings_method_name(i));
    if (s->frictions && !settings_all_serve(i))
        return instance_say(i, REFUSED,
            "%s: dry friction needs the multiplier iteration of solver.formulation residual with projections; choose "
            "it",
            s->name);
    arena_reset(i);
    i->flags.initialized = i->flags.known = i->flags.pending = 0;
    settings_upload_arguments(i);
    outcome = begin_run(i);
    arena_reset(i);
    outcome = laws_begun(i, outcome);
    i->flags.initialized = outcome == DONE;
    return outcome;
}

/* Set the start time and the stop time of a run. */
Outcome instance_begin(Instance *i, double start, double stop)
{
    if (!(stop >= start))
        return instance_say(i, REFUSED, "%s: the stop time is %g s; it must not be before the start at %g s",
            i->scene->name, stop, start);
    *instance_time(i) = start;
    i->stop = stop;
    return DONE;
}
