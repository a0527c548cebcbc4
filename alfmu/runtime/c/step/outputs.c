#include "outputs.h"

#include "balance.h"
#include "diagnosis.h"
#include "friction.h"
#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "message.h"
#include "rank.h"
#include "record.h"
#include "scene.h"
#include "scene_sizes.h"
#include "settings.h"
#include "variables.h"
#include "way.h"

/* Inputs above this are tested before they are accepted, because some outputs may overflow. */
#define TRIED 1e30

static Outcome set_input(Instance *i, int reference, double value)
{
    const Scene *s = i->scene;
    const int k = reference - s->parameters - s->choices;
    double *u = i->m + s->u + k, *slope = i->slopes + 1 + k;
    const double u_before = *u, slope_before = *slope;
    *u = value;
    *slope = s->no_slope;
    i->flags.known = 0;
    if (fabs(value) <= TRIED || !i->flags.initialized || instance_read(i) == DONE) {
        variable_changed_start(i, value != u_before || slope_before != s->no_slope);
        return DONE;
    }
    *u = u_before;
    *slope = slope_before;
    return instance_say(i, REFUSED, "%s: outputs are not finite with %s = %g %s; give a smaller value", s->name,
        s->variables[reference].name, value, s->variables[reference].unit);
}

/* Set a variable; a choice is set by its number, from 1 on. A rejected value leaves the previous one in force. */
Outcome instance_set(Instance *i, int reference, double value)
{
    const Variable *v = i->scene->variables + reference;
    Outcome outcome;
    if (v->kind == OUTPUT)
        return instance_say(i, REFUSED, "%s: %s is an output and cannot be set", i->scene->name, v->name);
    if (v->kind == CHOICE)
        return variable_set_choice(i, reference, value);
    outcome = variable_check(i, v, value);
    if (outcome != DONE)
        return outcome;
    if (v->kind == INPUT)
        return set_input(i, reference, value);
    if (v->kind == SWITCH)
        return variable_set_switch(i, reference, value);
    outcome = check_changeable(i, v);
    if (outcome == DONE)
        i->values[reference] = value;
    return outcome;
}

/* Set the tolerance that the host requests, if the integrator controls its error. */
Outcome instance_tolerate(Instance *i, double tolerance)
{
    return i->scene->method == 1 ? instance_set(i, i->scene->relative_tolerance, tolerance) : DONE;
}

/* Return the first output that is not finite, with its value; NULL if all are finite. */
static const char *find_not_finite(const Instance *i, double *value)
{
    const Scene *s = i->scene;
    const double *seen = i->m + s->seen;
    const int first = scene_first_output(s);
    for (int k = 0; k < s->outputs; k++)
        if (!isfinite(*value = instance_get(i, first + k)))
            return s->variables[first + k].name;
    for (int k = s->outputs - s->event_count; k < s->seen_size; k++)
        if (!isfinite(*value = seen[k]))
            return "|Phi-ddot|";
    return NULL;
}

/* Return whether all outputs are finite: zero times infinity or NaN is NaN. */
static int are_finite(const Instance *i)
{
    const Scene *s = i->scene;
    const double *seen = i->m + s->seen;
    double sums[4] = {0.0, 0.0, 0.0, 0.0}, events = *i->dissipated * 0.0;
    int k = 0;
    for (; k + 4 <= s->seen_size; k += 4)
        for (int j = 0; j < 4; j++)
            sums[j] += seen[k + j] * 0.0;
    for (; k < s->seen_size; k++)
        sums[0] += seen[k] * 0.0;
    for (k = 0; k < s->impulses; k++)
        events += i->impulses[k] * 0.0;
    return sums[0] + sums[1] + sums[2] + sums[3] + events == 0.0;
}

/* Update the largest errors; they are NaN if no monitor reads them. */
static void track_errors(Instance *i)
{
    const Scene *s = i->scene;
    const double *seen = instance_field(i, s->seen);
    double *c = i->counts;
    c[READS] += 1.0;
    c[POSITION_ERROR] = s->monitor_position < 0 ? NAN : fmax(c[POSITION_ERROR], seen[s->monitor_position]);
    c[VELOCITY_ERROR] = s->monitor_velocity < 0 ? NAN : fmax(c[VELOCITY_ERROR], seen[s->monitor_velocity]);
    c[ACCELERATION_ERROR] = fmax(c[ACCELERATION_ERROR], instance_diagnostic(i, SEEN_ACCELERATION_ERROR));
    c[ENERGY_ERROR] = s->monitor_energy < 0
        ? NAN
        : fmax(c[ENERGY_ERROR],
              fabs(seen[s->monitor_energy] - c[ENERGY_START] - instance_field(i, s->z)[s->work]));
}

/* Run a program that evaluates the outputs as limits at a singular position. It may change the direction of these
   limits, which is then restored, so that reading affects no step. */
static void run_limit(Instance *i, int program)
{
    const size_t arena = arena_mark(i), size = (size_t)scene_settings_length(i->scene);
    double *k = instance_field(i, i->scene->k), *before = arena_alloc(i, size);
    memcpy(before, k, size * sizeof *k);
    way_update(i);
    program_run(i, program);
    memcpy(k, before, size * sizeof *k);
    arena_release(i, arena);
}

/* Evaluate the outputs at this instant by loops that stop on convergence. */
static Outcome evaluate_patiently(Instance *i)
{
    const Scene *s = i->scene;
    const int instant = settings_instant(s);
    Outcome outcome = DONE;
    int limited = 0;
    double value;
    i->iterations = 0;
    program_run(i, instant);
    if (instance_diagnostic(i, SEEN_NEAR) != 0.0 && s->limit_patient >= 0) {
        run_limit(i, s->limit_patient);
        limited = !find_not_finite(i, &value);
        if (!limited)
            program_run(i, instant);
    }
    if (s->l && instant != s->instant && !limited)
        outcome = diagnose_convergence(i, i->workspace + s->watch0, *instance_time(i));
    else if (s->l && instant == s->instant
        && (instance_diagnostic(i, SEEN_TROUBLE) != 0.0 || (s->limit >= 0 && instance_diagnostic(i, SEEN_NEAR) != 0.0)))
        outcome = instance_say(i, FAILED,
            "%s, t = %.6g s: accelerations and reactions need more iterations here than this FMU contains; export it "
            "as --kind native, or use another start, smaller inputs or a smaller solver.step_size",
            s->name, *instance_time(i));
    if (s->monitor_iterations >= 0 && i->iterations > 0)
        i->m[s->seen + s->monitor_iterations] = i->iterations;
    return outcome;
}

/* Evaluate the outputs at this instant. Return 1 if all are finite and the position is not near a singular one. */
int outputs_read_away(Instance *i)
{
    const Scene *s = i->scene;
    if (!(i->flags.fast && outputs_read_quickly(i)))
        program_run(i, settings_instant(s));
    return are_finite(i) && instance_diagnostic(i, SEEN_NEAR) == 0.0;
}

Outcome instance_read(Instance *i)
{
    const Scene *s = i->scene;
    const double *z = instance_field(i, s->z);
    Outcome outcome = DONE;
    const char *name = NULL;
    char closer[120];
    double value;
    if (i->flags.known)
        return DONE;
    arena_reset(i);
    tape_begin_reading(i);
    settings_upload_arguments(i);
    if (i->flags.brakes)
        rank_freeze(i);
    if (!(i->flags.fast && outputs_read_quickly(i) && are_finite(i))) {
        outcome = evaluate_patiently(i);
        name = find_not_finite(i, &value);
    }
    if (outcome != DONE)
        return outcome;
    i->flags.known = !name;
    if (!name) {
        track_errors(i);
        balance_tell_step_error(i);
        return DONE;
    }
    if (friction_jammed(i))
        return friction_say_jam(i);
    if (settings_instant(s) != s->instant)
        outcome = diagnose_failure(i, z, z + s->n, z[s->time], i->workspace[s->watch0 + WATCH_PIVOT]);
    if (outcome != DONE)
        return outcome;
    return instance_say(i, FAILED,
        "%s, t = %.6g s: %s would be %g, as accelerations and reactions cannot be computed here; use smaller "
        "inputs%s%s%s",
        s->name, *instance_time(i), name, value,
        settings_moving(i) ? ", another start or a smaller solver.step_size" : " or another start",
        settings_or_penalty(i), settings_or_compliances(i, closer, sizeof closer));
}

/* Evaluate the outputs by few iterations, as the first stage of a quick step. Return 0 if more are needed. */
static int evaluate_by_few_iterations(Instance *i)
{
    const Scene *s = i->scene;
    const double *control = i->m + s->control;
    if (s->instant_quick < 0 || control[CONTROL_TIER] != 0.0
        || (control[CONTROL_METHOD] != 0.0 && !(s->reuses && s->short_step >= 0)))
        return 0;
    program_run(i, s->instant_quick);
    memcpy(i->read_at, i->m + s->z, 2 * (size_t)s->n * sizeof *i->m);
    memcpy(i->read_at + 2 * s->n, i->m + s->u, (size_t)s->inputs * sizeof *i->m);
    i->onward = s->reuses;
    return instance_diagnostic(i, SEEN_TROUBLE) == 0.0 && instance_diagnostic(i, SEEN_NEAR) == 0.0;
}

/* Evaluate the outputs by unrolled loops. Return 0 if their iterations do not suffice. */
int outputs_read_quickly(Instance *i)
{
    const Scene *s = i->scene;
    i->onward = 0;
    if (evaluate_by_few_iterations(i)) {
        i->counts[QUICK_READS] += 1.0;
        return 1;
    }
    program_run(i, s->instant);
    if (instance_diagnostic(i, SEEN_NEAR) != 0.0 && s->limit >= 0)
        run_limit(i, s->limit);
    return instance_diagnostic(i, SEEN_TROUBLE) == 0.0;
}

/* Get values of variables; if some outputs cannot be computed, get the others. */
Outcome outputs_get_many(Instance *i, const int *references, int count, double *values)
{
    const int first = scene_first_output(i->scene);
    Outcome outcome = DONE;
    int reads = 0;
    for (int k = 0; k < count; k++)
        reads |= references[k] >= first;
    if (reads)
        outcome = instance_read(i);
    instance_get_many(i, references, count, values);
    return outcome;
}
