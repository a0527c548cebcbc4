/* Steps where the tiers of the kernel fail: by loops that stop on convergence, in halves, or by RK4 with error
   control. */

#include "robust.h"

#include "adaptive.h"
#include "diagnosis.h"
#include "equations.h"
#include "fixed.h"
#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "linear.h"
#include "message.h"
#include "projection.h"
#include "rank.h"
#include "record.h"
#include "scene.h"
#include "scene_sizes.h"
#include "settings.h"
#include "text.h"
#include "way.h"

/* Part of an internal step within which a force ends that no step crosses. */
#define AHEAD 1e-4

/* S2 to S5: take one internal step by loops that stop on convergence; set `near` if it came near a singular
   position. */
static Outcome step_patient(Instance *i, double start, double dt, int *near)
{
    const Scene *s = i->scene;
    const int watch[] = {s->watch1, s->watch2, s->watch3, s->watch4};
    double *m = i->m, *w = i->workspace, *after = m + s->after;
    const double t = start + dt;
    Outcome outcome;
    *near = 0;
    i->left -= PATIENT_STEP;
    if (i->left < 0)
        return diagnose_too_much(i);
    instance_set_time(i, start);
    if (s->move < 0 && !s->l && diagnose_ahead(i, dt) != DONE)
        return FAILED;
    if (s->move < 0)
        return instance_say(i, FAILED,
            "%s, t = %.6g s: %s; reduce solver.step_size",
            s->name, t,
            s->l ? "a step needs more iterations than this scene contains"
                 : "the state is not finite, or turned by more than half a turn in one step");
    m[s->dt] = dt;
    if (i->flags.brakes)
        rank_freeze(i);
    program_run(i, s->move);
    outcome = diagnose_state(i, start, dt);
    if (outcome != DONE)
        return outcome;
    for (int k = 0; k < 4; k++)
        *near |= w[watch[k] + WATCH_NEAR] != 0.0;
    *near = *near && instance_field(i, s->k)[SETTINGS_CONTINUES] != 0.0;
    if (*near) {
        way_update(i);
        w[s->on_branch] = 1.0;
        program_run(i, s->move);
        w[s->on_branch] = 0.0;
        for (int k = 0; k < 4; k++)
            if (w[watch[k]] == INFINITY) /* Infinity marks a branch that leaves a constraint open. */
                return instance_say(i, CONSTRAINT_OPEN,
                    "%s, t = %.6g s: a constraint does not close ahead on the branch of the motion; reduce "
                    "solver.step_size",
                    s->name, start);
    }
    outcome = diagnose_state(i, start, dt);
    if (outcome == DONE)
        outcome = diagnose_length(i, t);
    if (outcome == DONE && settings_project(i))
        outcome = projection_close(i, t);
    else if (outcome == DONE) {
        program_run(i, s->close);
        projection_watch_gaps(i);
    }
    if (outcome == DONE && !isfinite(linear_norm(after + s->work + 1, scene_states(s))))
        outcome = instance_say(i, FAILED, "%s, t = %.6g s: a state is not finite; reduce solver.step_size", s->name, t);
    for (int k = 0; k < 4 && outcome == DONE; k++)
        outcome = diagnose_convergence(i, w + watch[k], t);
    if (outcome != DONE)
        return outcome;
    after[s->trouble] = 0.0;
    step_commit(i);
    return DONE;
}

/* S5: divide an internal step near a singular position into shorter ones. */
static Outcome step_bisected(Instance *i, double start, double dt)
{
    const Scene *s = i->scene;
    const double *q = instance_field(i, s->z);
    double t = 0.0, h = dt / 2;
    char where[400] = "";
    int near;
    while (t < dt && h > dt * SHORTEST) {
        const Outcome outcome = step_patient(i, start + t, h, &near);
        if (outcome == DONE) {
            const double rest = dt - t - h;
            t += h;
            h = fmin(2 * h, rest);
        } else if (outcome == CONSTRAINT_OPEN)
            h /= 2;
        else
            return outcome;
    }
    if (t >= dt)
        return DONE;
    for (int c = 0; c < s->n && c < SAID; c++) {
        char part[64];
        write_text(part, sizeof part, "%s%.40s = %.6g", c ? ", " : "", s->coordinates[c].name, q[c]);
        strncat(where, part, sizeof where - strlen(where) - 1);
    }
    return instance_say(i, FAILED,
        "%s, t = %.6g s: locked up at %s; no motion continues from this singular position (distance %.1e); reverse "
        "before it, or change lengths or start",
        s->name, start + t, where, sqrt(settings_margin(i, q)));
}

Outcome step_robust(Instance *i, double start, double dt)
{
    int near;
    const Outcome outcome = step_patient(i, start, dt, &near);
    if (outcome == CONSTRAINT_OPEN && near)
        return step_bisected(i, start, dt);
    return outcome;
}

/* Return the error, relative to the tolerance, of an RK4 step: `whole` is its result in one step, the state its
   result in two halves. Near a singular position velocities are weighted by their energy, because those that C
   hardly constrains are round-off. */
static double halves_error(Instance *i, const double *begin, const double *whole, int near)
{
    const Scene *s = i->scene;
    const double *z = i->m + s->z, *k = i->m + s->k, relative = k[SETTINGS_RELATIVE];
    double found = 0.0, kinetic, other;
    for (int c = 0; c < s->time; c++) {
        const char *unit = c < 2 * s->n ? s->coordinates[c % s->n].unit : "";
        const double size = fmax(fmax(fabs(begin[c]), fabs(z[c])), fabs(whole[c]));
        const double one = !strcmp(unit, "m") ? *i->length : 1.0,
                     most = *unit && c < s->n && strcmp(unit, "1") ? one : size;
        const double allowed = (*unit ? k[SETTINGS_ABSOLUTE] * one : 0.0) + relative * fmin(size, most);
        if (*unit ? !near || c < s->n : c > s->work)
            found = fmax(found, fabs(z[c] - whole[c]) / (allowed + ROUND_OFF * size + DBL_MIN));
    }
    if (near) {
        energy_evaluate(i, z + s->n, &kinetic);
        energy_evaluate(i, whole + s->n, &other);
        found = fmax(found, fabs(kinetic - other) / (2.0 * relative * kinetic + DBL_MIN));
    }
    return found / 15.0; /* Richardson extrapolation */
}

/* Take an RK4 step by the kernel or by loops that stop on convergence, whatever the integrator of the scene. */
Outcome step_rk4(Instance *i, double start, double dt)
{
    Outcome outcome;
    i->left--;
    if (i->flags.brakes)
        rank_freeze(i);
    if (i->flags.fast && step_fixed(i, 1, dt) == 1)
        return DONE;
    outcome = step_robust(i, start, dt);
    i->counts[PATIENT_STEPS] += outcome == DONE;
    return outcome;
}

/* Take an RK4 step by loops that stop on convergence where the integrator of the scene fails, with a length that
   meets the tolerance. Near a singular position round-off may exceed it; the tolerance of the run then applies. */
static Outcome step_rk4_controlled(Instance *i, double end)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), size = scene_state_length(s) * sizeof(double);
    double *z = instance_field(i, s->z), *begin = arena_alloc(i, scene_state_length(s)),
           *whole = arena_alloc(i, scene_state_length(s));
    const double start = *instance_time(i), left = end - start;
    const int near = instance_field(i, s->after)[s->near] != 0.0;
    const Mark mark = tape_mark(i);
    double h = fmin(left, i->values[s->step_size]), error = INFINITY, before;
    Outcome outcome = FAILED;
    memcpy(begin, z, size);
    if (near && diagnose_laws(i, start + h) != DONE) { /* Steps to a dead position would become ever shorter. */
        arena_release(i, arena);
        return FAILED;
    }
    for (; h >= fmin(GIVEN_UP, left) && i->left > 0 && !run_is_ended(i); h *= SHORTENED) {
        before = error;
        error = INFINITY;
        outcome = step_robust(i, start, h);
        if (outcome == DONE) {
            memcpy(whole, z, size);
            memcpy(z, begin, size);
            tape_cut(i, mark);
            outcome = step_robust(i, start, h / 2);
            if (outcome == DONE)
                outcome = step_robust(i, start + h / 2, h / 2);
            error = outcome == DONE ? halves_error(i, begin, whole, near) : INFINITY;
        }
        if (error <= 1.0 || (error >= before && error * s->share <= 1.0))
            break;
        memcpy(z, begin, size);
        tape_cut(i, mark);
        outcome = outcome == DONE ? NO_STEP_ON : outcome; /* The step succeeded, but not within the tolerance. */
    }
    arena_release(i, arena);
    if (outcome == DONE) {
        i->counts[PATIENT_STEPS] += 2.0;
        instance_set_time(i, h < left * (1 - ONE_STEP) ? start + h : end);
        instance_field(i, s->pace)[PACE_DT] = h;
        /* The data that the integrator keeps between steps are invalid here. */
        instance_field(i, s->pace)[PACE_LAST] = 0.0;
        return DONE;
    }
    if (i->ended)
        return diagnose_interrupted(i);
    if (i->left <= 0)
        return diagnose_too_much(i);
    if (near && outcome != NO_STEP_ON)
        return outcome;
    if (!settings_moving(i))
        return instance_say(i, FAILED,
            "%s, t = %.6g s: the motion cannot begin: accelerations jump here or are not finite, or constraints cannot "
            "be kept; "
            "check forces, laws and constraints at this time%s",
            s->name, start, settings_or_penalty(i));
    if (diagnose_ahead(i, AHEAD * i->values[s->step_size]) != DONE)
        return FAILED;
    return instance_say(i, FAILED,
        "%s, t = %.6g s: no step however short meets the tolerance; check quotients and signs in forces, raise "
        "solver.relative_tolerance, or use smaller inputs%s",
        s->name, start, settings_or_penalty(i));
}

/* Take one step, or all steps to the end of a communication step, by the integrator of the scene; steps of fixed
   length take dt. */
Outcome step_adaptive_to(Instance *i, double end, double dt, int once)
{
    const Scene *s = i->scene;
    double *time = instance_time(i), *pace = instance_field(i, s->pace);
    const double from = *time;
    if (!once)
        pace[PACE_LAST] = 0.0;
    pace[PACE_FIXED] = settings_method(i) == 2 ? dt : 0.0;
    while (*time < end && !(once && *time > from)) {
        if (i->left <= 0)
            return diagnose_too_much(i);
        if (end - *time <= instance_least_step(i)) {
            const Outcome outcome = step_rk4(i, *time, end - *time);
            pace[PACE_LAST] = 0.0; /* The data that the integrator keeps between steps are invalid here. */
            if (outcome == DONE)
                *time = end;
            return outcome;
        }
        if (i->flags.brakes)
            rank_freeze(i);
        if (step_adaptive(i, end, once || i->flags.brakes ? 1 : i->left))
            continue;
        if (i->ended)
            return diagnose_interrupted(i);
        if (settings_method(i) == 1) {
            const Outcome outcome = step_rk4_controlled(i, end);
            if (outcome != DONE)
                return outcome;
            continue;
        }
        return instance_say(i, FAILED,
            "%s, t = %.6g s: a step by solver.method %s failed; near singular positions, and where constraints stay "
            "open, "
            "use explicit or rk4%s",
            s->name, *time, settings_method_name(i), settings_or_penalty(i));
    }
    return DONE;
}
