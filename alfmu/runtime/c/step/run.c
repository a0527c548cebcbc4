#include "run.h"

#include "balance.h"
#include "begin.h"
#include "breaks.h"
#include "diagnosis.h"
#include "driving_inputs.h"
#include "equations.h"
#include "fixed.h"
#include "friction_events.h"
#include "instance.h"
#include "interface_jacobian.h"
#include "interpret.h"
#include "jumps.h"
#include "layout.h"
#include "message.h"
#include "outputs.h"
#include "peaks.h"
#include "projection.h"
#include "rank.h"
#include "robust.h"
#include "scene.h"
#include "scene_sizes.h"
#include "settings.h"
#include "state.h"
#include "topology.h"
#include "variables.h"

/* Integrate from one time to another with no break between them. RK4 has taken `made` steps in one call and failed
   at the next; `made` is negative if it has not tried. */
static Outcome integrate_stretch(Instance *i, double start, double end, long made)
{
    const Scene *s = i->scene;
    const double h = end - start, steps = settings_internal_steps(i, h), dt = h / steps;
    double done = 0.0;
    Outcome outcome = DONE;
    instance_set_time(i, start);
    if (s->frictions) {
        instance_field(i, s->pace)[PACE_LAST] = 0.0;
        return friction_cover(i, start, h, dt);
    }
    if (settings_method(i) && !(i->broken && h < LEFT_TO_RK4 * GIVEN_UP))
        return step_adaptive_to(i, end, dt, 0);
    while (done < steps && outcome == DONE) {
        if (run_is_ended(i))
            outcome = diagnose_interrupted(i);
        else if (i->flags.fast && done != (double)made) {
            const double left = (double)made > done ? (double)made - done : steps - done;
            const long wanted = i->flags.whole ? (long)left : 1L;
            long taken;
            instance_set_time(i, start + done * dt);
            if (i->flags.brakes)
                rank_freeze(i);
            taken = step_fixed(i, wanted, dt);
            done += (double)taken;
            if (taken == wanted)
                continue;
        }
        if (done < steps && outcome == DONE && !i->ended) {
            outcome = step_robust(i, start + done * dt, dt);
            i->counts[PATIENT_STEPS] += outcome == DONE;
            done += 1.0;
        }
    }
    return outcome;
}

/* Pass over a break, from just before to just after it. A jump of a law's rate is an impact. */
static Outcome pass_break(Instance *i, double to)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *q = instance_field(i, s->z), *v = q + s->n, *energies = arena_alloc(i, 4);
    const double dt = to - *instance_time(i);
    Outcome outcome = DONE;
    int row;
    for (int c = 0; c < scene_coordinates(s); c++)
        q[c] += dt * v[c];
    instance_set_time(i, to);
    i->onward = 0; /* The last outputs were those before the break. */
    peaks_broken(i);
    if (s->timed && s->l && settings_project(i) && !(constraints_widest(i, q, v, 1, &row) <= GROSS)) {
        energy_record(i, v, energies);
        outcome = projection_apply(i, q, v);
        energy_add_jump(i, energies);
    }
    arena_release(i, arena);
    return outcome;
}

/* Take a communication step that the kernel cannot take in one call. RK4 has taken `made` internal steps and failed
   at the next; `made` is negative if it has not tried. */
static Outcome step_over_breaks(Instance *i, double start, double h, long made)
{
    const Scene *s = i->scene;
    const size_t size = scene_state_length(s) * sizeof(double), count = (size_t)(s->past + s->past_size - s->pace);
    double *z = instance_field(i, s->z), *begin = instance_field(i, s->begin), *pace = instance_field(i, s->pace),
           *before = arena_alloc(i, count);
    double from = start;
    Outcome outcome = DONE;
    memcpy(begin, z, size);
    memcpy(before, pace, count * sizeof *pace);
    if (!settings_method(i) || i->flags.brakes) /* These steps do not start from the evaluation of the outputs. */
        i->onward = 0;
    instance_set_time(i, start);
    if (s->reach >= 0)
        program_run(i, s->reach);
    for (int k = 0; k <= i->broken && outcome == DONE; k++) {
        const double *about = k < i->broken ? i->breaks + 2 * k : NULL,
                     to = about ? fmin(about[0], start + h) : start + h;
        if (to > from)
            outcome = integrate_stretch(i, from, to, made);
        if (about && outcome == DONE)
            outcome = pass_break(i, from = fmax(from, fmin(about[1], start + h)));
    }
    if (outcome == DONE) {
        instance_set_time(i, start + h);
    } else {
        memcpy(z, begin, size);
        settings_count_turns(i);
        memcpy(pace, before, count * sizeof *pace);
    }
    return outcome;
}

/* Return whether the host's time equals the time of the state, to a millionth of the step or to the precision of a
   host with 32-bit times. */
static int is_current_time(Instance *i, double start, double h)
{
    const double time = *instance_time(i), apart = fabs(start - time);
    if (!isfinite(start) || apart <= 1e-6 * h + 1e-12 * fabs(time))
        return isfinite(start);
    if (!(fabs(start) < FLT_MAX && (double)(float)start == start
            && apart <= FLT_EPSILON * fmax(fabs(start), fabs(time))))
        return 0;
    instance_warn(i, WARNED_OF_TIME,
        "%s, t = %.9g s: the host steps from %.9g s, a time rounded to 32 bits; the run continues from there, and "
        "laws of time are accurate to %.0e s only; keep the time in 64 bits in the host",
        i->scene->name, time, start, FLT_EPSILON * fabs(start));
    return 1;
}

/* Return DONE, or the reason why a communication step cannot be taken from here in one call. */
Outcome instance_can_step(Instance *i, double start, double h)
{
    const Scene *s = i->scene;
    const double time = *instance_time(i), steps = settings_internal_steps(i, h);
    if (!(isfinite(h) && h > 0.0))
        return instance_say(
            i, REFUSED, "%s, t = %.6g s: a communication step of %g s; it must be above zero", s->name, time, h);
    if (!is_current_time(i, start, h))
        return instance_say(
            i, REFUSED, "%s: a step from t = %g s is asked for, but the state is at t = %g s", s->name, start, time);
    if (!(steps <= MOST_STEPS))
        return instance_say(i, REFUSED,
            "%s, t = %.6g s: a communication step of %g s takes %.3g internal steps, more than %d; take shorter "
            "communication steps, or increase solver.step_size (%g s)",
            s->name, time, h, steps, MOST_STEPS, i->values[s->step_size]);
    if (start + h > i->stop && start + h - i->stop > 1e-6 * h + FLT_EPSILON * fabs(i->stop))
        return instance_say(i, NO_STEP_ON,
            "%s, t = %.6g s: a step of %g s leads past the stop time of %g s that the host gave; end the run there, or "
            "give "
            "a later stop time or none",
            s->name, time, h, i->stop);
    /* A step of at most LEFT_TO_RK4 * GIVEN_UP may be lost in round-off: it has no visible effect. */
    if (!(start + h / steps > (steps > 1.0 ? nextafter(start, INFINITY) : start)) && h > LEFT_TO_RK4 * GIVEN_UP)
        return instance_say(i, REFUSED,
            "%s, t = %.6g s: steps of %g s are below the resolution of the time; take longer ones, or begin at 0 s",
            s->name, time, h / steps);
    return DONE;
}

/* Return the length of the memory from the internal step to past inputs, which steps keep besides the motion. */
static size_t step_memory_length(const Scene *s)
{
    return (size_t)(s->past + s->past_size - s->dt);
}

/* Save everything that a step may change, except the state at its beginning, which the step itself saves. */
static void remember_step(Instance *i)
{
    const Scene *s = i->scene;
    double *to = i->before;
    memcpy(to, i->slopes, (size_t)(s->inputs + 1) * sizeof *to);
    memcpy(to += s->inputs + 1, i->m + s->u, (size_t)s->inputs * sizeof *to);
    memcpy(to += s->inputs, i->counts, COUNTED * sizeof *to);
    memcpy(to + COUNTED, i->m + s->dt, step_memory_length(s) * sizeof *to);
}

static void take_step_back(Instance *i)
{
    const Scene *s = i->scene;
    const double *from = i->before;
    memcpy(i->m + s->z, i->m + s->begin, scene_state_length(s) * sizeof *from);
    settings_count_turns(i);
    memcpy(i->slopes, from, (size_t)(s->inputs + 1) * sizeof *from);
    memcpy(i->m + s->u, from += s->inputs + 1, (size_t)s->inputs * sizeof *from);
    memcpy(i->counts, from += s->inputs, COUNTED * sizeof *from);
    memcpy(i->m + s->dt, from + COUNTED, step_memory_length(s) * sizeof *from);
    i->flags.known = 0;
}

/* Take a communication step and evaluate the outputs at its end; it fails if they cannot be evaluated. */
static Outcome make_communication_step(Instance *i, double start, double h)
{
    const Scene *s = i->scene;
    Outcome outcome = DONE;
    long made = -1;
    /* Steps of other integrators than RK4 are counted only in the slower way, which also takes back no step along which
       derivatives were propagated. */
    if (!i->flags.whole || settings_method(i) || s->frictions || s->entries || i->broken
        || !step_fixed_whole(i, start, h, &made))
        outcome = step_over_breaks(i, start, h, made);
    if (outcome != DONE)
        return outcome;
    for (int k = 0; k < s->inputs; k++) {
        if (isfinite(i->slopes[1 + k]))
            i->m[s->u + k] += h * i->slopes[1 + k];
        i->slopes[1 + k] = s->no_slope;
    }
    i->flags.known = 0;
    outcome = instance_read(i);
    if (outcome == DONE) {
        instance_balance(i);
        balance_tell_step_error(i);
    }
    return outcome == DONE && s->entries ? jacobian_end(i) : outcome;
}

/* Find the breaks up to an end. Return DONE if they permit a step. */
static Outcome look_ahead(Instance *i, double start, double end)
{
    const Outcome outcome = breaks_found(i, start, end);
    return outcome == DONE ? laws_checked(i, end) : outcome;
}

/* Apply the requested Boolean inputs and return DONE if a communication step can begin. Otherwise drop these
   requests and change nothing else. */
Outcome instance_ready(Instance *i, double start, double h)
{
    Outcome outcome = DONE;
    if (!i->flags.initialized)
        return instance_say(i, REFUSED, "%s: initialise before the first step", i->scene->name);
    outcome = instance_can_step(i, start, h);
    if (outcome == DONE && i->scene->followed_count && !i->within) {
        outcome = inputs_aim(i, start, h);
        settings_upload_parameters(i);
        i->flags.known = 0;
    }
    if (outcome == DONE && !i->flags.pending)
        return look_ahead(i, start, start + h);
    if (outcome != DONE)
        return outcome;
    arena_reset(i);
    instance_remember(i);
    settings_upload_arguments(i);
    outcome = topology_take_effect(i);
    if (outcome == DONE)
        outcome = look_ahead(i, start, start + h);
    if (outcome != DONE) {
        instance_go_back(i);
        memcpy(i->requested, i->active, (size_t)i->scene->switches * sizeof *i->active);
        i->flags.pending = 0;
    }
    arena_reset(i);
    return outcome;
}

/* Restore the inputs after a failed step. */
static void restore_inputs(Instance *i)
{
    const Scene *s = i->scene;
    if (!s->followed_count)
        return;
    memcpy(i->discrete, i->kept_before, (size_t)s->held * sizeof *i->discrete);
    memcpy(i->input_history, i->kept_before + s->held, (size_t)s->followed_count * HEARD * sizeof *i->input_history);
    settings_upload_parameters(i);
}

/* Let inputs follow their slopes in a step from this time. */
static void follow_slopes(Instance *i, double start)
{
    const Scene *s = i->scene;
    settings_upload_arguments(i);
    i->slopes[0] = start;
    memcpy(i->workspace + s->slopes, i->slopes, (size_t)(s->inputs + 1) * sizeof *i->slopes);
}

static Outcome step_once(Instance *i, double start, double h)
{
    const Scene *s = i->scene;
    const int changed = i->flags.pending || s->frictions, pending = i->flags.pending;
    Outcome outcome;
    if (s->followed_count) {
        memcpy(i->kept_before, i->discrete, (size_t)s->held * sizeof *i->discrete);
        memcpy(
            i->kept_before + s->held, i->input_history, (size_t)s->followed_count * HEARD * sizeof *i->input_history);
    }
    outcome = instance_ready(i, start, h);
    if (outcome != DONE) {
        restore_inputs(i);
        return outcome;
    }
    if (changed && !pending) /* A step may change which joints stick. */
        instance_remember(i);
    arena_reset(i);
    if (!i->within)
        i->left = MOST_STEPS, i->crossings = 0;
    if (!changed)
        remember_step(i);
    follow_slopes(i, start);
    if (s->peaks && !i->within)
        peaks_begin(i);
    outcome = make_communication_step(i, start, h);
    if (outcome != DONE && outcome != REFUSED && !i->ended && diagnose_laws(i, start + h) != DONE)
        outcome = FAILED;
    if (outcome != DONE && changed)
        instance_go_back(i);
    else if (outcome != DONE)
        take_step_back(i);
    if (outcome != DONE)
        restore_inputs(i);
    arena_reset(i);
    return outcome;
}

Outcome instance_step(Instance *i, double start, double h)
{
    Outcome outcome;
    if (!i->scene->entries || i->tape) /* A run with derivatives has a tape of its own. */
        return step_once(i, start, h);
    outcome = jacobian_begin(i);
    if (outcome == DONE)
        outcome = step_once(i, start, h);
    i->tape = NULL;
    return outcome;
}

/* Number of samples for derivatives of outputs, their distance in internal steps, and their weights. */
#define PLACES 5
#define APART 0.03125
static const double difference[2][PLACES] = {
    {-25.0 / 12, 4.0, -3.0, 4.0 / 3, -1.0 / 4},
    {35.0 / 12, -26.0 / 3, 19.0 / 2, -14.0 / 3, 11.0 / 12},
};

/* Compute time derivatives of outputs by one-sided differences along a short motion, which is then taken back: of
   order 4 for first derivatives, of order 3 for second ones. Inputs continue with their present slopes; Boolean
   inputs not yet applied are ignored. */
Outcome instance_output_derivatives(
    Instance *i, const unsigned *references, const int *orders, size_t count, double *values)
{
    const Scene *s = i->scene;
    const double start = *instance_time(i), h = APART * i->values[s->step_size];
    Outcome outcome = DONE;
    instance_remember(i);
    i->left = MOST_STEPS;
    i->flags.pending = 0;
    memset(values, 0, count * sizeof *values);
    for (int k = 0; outcome == DONE && k < PLACES; k++) {
        if (k) {
            arena_reset(i);
            i->within = k > 1;
            follow_slopes(i, start + (k - 1) * h);
            outcome = step_over_breaks(i, start + (k - 1) * h, h, -1);
            for (int each = 0; each < s->inputs; each++)
                if (isfinite(i->slopes[1 + each]))
                    i->m[s->u + each] += h * i->slopes[1 + each];
            i->flags.known = 0;
        }
        if (outcome == DONE)
            outcome = instance_read(i);
        for (size_t each = 0; outcome == DONE && each < count; each++)
            values[each] += difference[orders[each] - 1][k] * instance_get(i, (int)references[each]);
    }
    for (size_t each = 0; each < count; each++)
        values[each] /= orders[each] == 1 ? h : h * h;
    instance_go_back(i);
    i->within = 0;
    arena_reset(i);
    for (size_t each = 0; outcome == DONE && each < count; each++)
        if (!isfinite(values[each]))
            outcome = instance_say(i, FAILED, "%s, t = %.6g s: derivative %d of %s would be %g", s->name, start,
                orders[each], s->variables[references[each]].name, values[each]);
    return outcome;
}
