#include "diagnosis.h"

#include "equations.h"
#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "linear.h"
#include "loops.h"
#include "message.h"
#include "scene.h"
#include "scene_sizes.h"
#include "settings.h"

/* Return FAILED if the diagnostics of an evaluation (`watch`) show that the multiplier iteration with a given
   penalty ended too far from convergence for a valid acceleration. Count smaller remainders. */
Outcome diagnose_convergence(Instance *i, const double *watch, double t)
{
    const Scene *s = i->scene;
    const double tolerance = i->values[s->tolerance], alpha = i->values[s->penalty];
    const double left = sqrt(watch[WATCH_CHANGE] / (watch[WATCH_SIZE] + DBL_MIN));
    if (watch[WATCH_CHANGE] <= tolerance * tolerance * watch[WATCH_SIZE] + DBL_MIN)
        return DONE;
    i->counts[UNCONVERGED] += 1.0;
    if (!(left > UNFINISHED) || !penalty_is_given(i) || instance_field(i, s->k)[SETTINGS_CONTINUES] == 0.0) {
        instance_warn(i, WARNED_OF_UNCONVERGED,
            "%s, t = %.6g s: an evaluation ended without convergence after %g passes of the multiplier iteration; %s, "
            "or "
            "raise solver.max_iterations",
            s->name, t, i->values[s->max_iterations], settings_remedy(i));
        return DONE;
    }
    return instance_say(i, FAILED,
        "%s, t = %.6g s: with solver.penalty %g the multiplier iteration still changes accelerations by a relative "
        "%.1e after %g passes, above the limit of %.0e; %s, or raise solver.max_iterations",
        s->name, t, alpha > 0.0 ? alpha : linear_largest(i->penalty, s->l), left, i->values[s->max_iterations],
        UNFINISHED, settings_remedy(i));
}

/* Return DONE if accelerations can be computed at q, v; `pivot` is the smallest pivot factorised there. */
Outcome diagnose_failure(Instance *i, const double *q, const double *v, double t, double pivot)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *M = arena_alloc(i, (size_t)s->mass.entries), *C = arena_alloc(i, (size_t)s->constraint.entries);
    double *F = arena_alloc(i, (size_t)s->n), *xi = arena_alloc(i, (size_t)s->l),
           *u = arena_alloc(i, (size_t)scene_driven(s));
    const double *x[] = {q, v, u, instance_field(i, s->p), &t};
    double *y[] = {M, C, F, xi};
    Outcome outcome = DONE;
    memcpy(u, instance_field(i, s->u), (size_t)s->inputs * sizeof *u);
    memcpy(u + s->inputs, instance_states(i), (size_t)scene_states(s) * sizeof *u);
    function_call(i, s->dynamics, x, y);
    if (!isfinite(linear_largest(M, s->mass.entries)) || !isfinite(linear_largest(F, s->n))
        || !isfinite(linear_largest(xi, s->l)))
        outcome = instance_say(i, FAILED, "%s, t = %.6g s: the equations of motion are not finite; %s%s", s->name, t,
            settings_moving(i) ? "check roots, logarithms and quotients in forces, or " : "", settings_or_shorter(i));
    else if (!(pivot > 0.0))
        outcome = instance_say(i, FAILED,
            "%s, t = %.6g s: the augmented mass matrix is singular; give the massless body a mass, or hold it by "
            "constraints; if a mass or an inertia is some 1e12 times less than the others, make it larger; if a body "
            "is some 1e4 times as long as the link that turns it, give the body a pose%s",
            s->name, t, settings_or_penalty(i));
    arena_release(i, arena);
    return outcome;
}

/* Return FAILED if the equations of motion are not finite within a time after the state, as where a root in a force
   ends. */
Outcome diagnose_ahead(Instance *i, double within)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    const double *z = instance_field(i, s->z), *v = z + s->n;
    double *q = arena_alloc(i, (size_t)s->n);
    Outcome outcome = DONE;
    for (double h = GIVEN_UP; outcome == DONE && h <= within; h = h < within ? fmin(10.0 * h, within) : INFINITY) {
        for (int c = 0; c < s->n; c++)
            q[c] = z[c] + h * v[c];
        outcome = diagnose_failure(i, q, v, *instance_time(i) + h, 1.0);
    }
    arena_release(i, arena);
    if (outcome == DONE)
        return DONE;
    return instance_say(i, FAILED,
        "%s, t = %.6g s: the equations of motion are not finite from here on; check roots, logarithms and quotients in "
        "forces",
        s->name, *instance_time(i));
}

/* Return FAILED if a step from `start` ends at a state that is not finite, and name its first stage that failed. */
Outcome diagnose_state(Instance *i, double start, double dt)
{
    const Scene *s = i->scene;
    const double *w = i->workspace;
    const struct {
        int watch, q, v;
        double t;
    } stages[] = {{s->watch1, s->q1, s->v1, start}, {s->watch2, s->q2, s->v2, start + dt / 2},
        {s->watch3, s->q3, s->v3, start + dt / 2}, {s->watch4, s->q4, s->v4, start + dt}};
    if (isfinite(linear_norm(w + s->q, s->n)) && isfinite(linear_norm(w + s->v, s->n)))
        return DONE;
    for (int k = 0; k < 4; k++) {
        const double pivot = w[stages[k].watch + WATCH_PIVOT];
        const Outcome outcome = diagnose_failure(i, w + stages[k].q, w + stages[k].v, stages[k].t, pivot);
        if (outcome != DONE)
            return outcome;
    }
    return instance_say(
        i, FAILED, "%s, t = %.6g s: the state is not finite; reduce solver.step_size", s->name, start + dt);
}

/* Return FAILED if a step to the positions in the workspace is too long, or opens a constraint that projections
   should close. */
Outcome diagnose_length(Instance *i, double t)
{
    const Scene *s = i->scene;
    const double *q = i->workspace + s->q, *v = i->workspace + s->v, *from = instance_field(i, s->z);
    double turned = 0.0, moved = 0.0, gap;
    char label[100];
    int worst = 0, row;
    for (int c = 0; c < scene_coordinates(s); c++) {
        const double size = fabs(q[c] - from[c]);
        moved = fmax(moved, strcmp(s->coordinates[c].unit, "m") ? size : size / *i->length);
        if (!strcmp(s->coordinates[c].unit, "rad") && size > turned) {
            turned = size;
            worst = c;
        }
    }
    if (turned > TURN)
        return instance_say(i, FAILED,
            "%s, t = %.6g s: %s turned by %.3g rad in one step, more than half a turn; reduce solver.step_size",
            s->name, t, s->coordinates[worst].name, turned);
    if (!settings_project(i))
        return DONE;
    gap = constraints_widest(i, q, v, 0, &row);
    if (gap > TORN * moved && gap > GROSS)
        return instance_say(i, FAILED, "%s, t = %.6g s: a step of %.3g opened %s by %.3g; reduce solver.step_size",
            s->name, t, moved, instance_row_label(i, row, label, sizeof label), gap);
    return DONE;
}

/* Largest turn [rad] or way, over the length of the mechanism, between two positions to which laws lead, and how many
   such positions are looked at. */
#define LED 0.1
#define MOST_LED 200

/* Return FAILED if laws of motion lead to a position before `end` at which the loops cannot be closed, as there is
   none beyond a dead position. Positions follow each other so closely that each is found from the one before. */
Outcome diagnose_laws(Instance *i, double end)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n;
    double *q, *before, t = *instance_time(i), open = t, speed = 0.0, dt;
    unsigned char *held;
    char label[100] = "";
    Loops loops;
    if (!s->timed || !s->l)
        return DONE;
    q = arena_alloc(i, n);
    before = arena_alloc(i, n);
    held = (unsigned char *)arena_alloc(i, (size_t)s->l);
    for (int r = 0; r < s->l; r++)
        held[r] = i->penalty[r] > 0.0;
    for (int k = 0; k < s->frictions; k++) /* A joint that sticks may slip. */
        held[s->friction[k].row] = 0;
    loops = loops_new(i, held, *i->length);
    loops.untied = 1;
    memcpy(q, instance_field(i, s->z), n * sizeof *q);
    for (int c = 0; c < scene_coordinates(s); c++)
        speed = fmax(speed, fabs(instance_field(i, s->z)[s->n + c]) / loops.units[c]);
    dt = LED / fmax(speed, LED / (end - t));
    for (int k = 0; k < MOST_LED && t < end && dt > 1e-9 * (end - t); k++) {
        memcpy(before, q, n * sizeof *q);
        q[s->n - 1] = t + fmin(dt, end - t);
        loops_follow(i, &loops, q);
        if (loops_close(i, &loops, q)) {
            t = before[s->n - 1] = q[s->n - 1];
            dt *= *label ? 0.5 : fmin(2.0, LED / fmax(coordinates_apart(s, loops.units, before, q), LED / 2));
            continue;
        }
        if (!*label) {
            open = q[s->n - 1];
            loops_gap_label(i, &loops, label, sizeof label);
        }
        memcpy(q, before, n * sizeof *q);
        dt /= 2;
    }
    arena_release(i, arena);
    if (!*label)
        return DONE;
    return instance_say(i, FAILED,
        "%s, t = %.6g s: its laws lead on to positions at which the loops cannot be closed; at t = %.6g s the nearest "
        "one leaves %s; check that they agree, and let them turn round before a dead position",
        s->name, t, open, label);
}

/* Report a communication step that exceeds the work limit of one call. */
Outcome diagnose_too_much(Instance *i)
{
    return instance_say(i, FAILED,
        "%s, t = %.6g s: more than %d internal steps in one communication step (repeated steps count; each that "
        "iterates to convergence counts as %d); take shorter communication steps, or increase solver.step_size or the "
        "tolerances%s",
        i->scene->name, *instance_time(i), MOST_STEPS, PATIENT_STEP, settings_or_penalty(i));
}

/* Report that the caller ended the run within a communication step. */
Outcome diagnose_interrupted(Instance *i)
{
    return instance_say(i, FAILED, "%s, t = %.6g s: interrupted", i->scene->name, *instance_time(i));
}

Outcome diagnose_derivatives(Instance *i)
{
    const Scene *s = i->scene;
    if (s->frictions)
        return instance_say(i, REFUSED,
            "%s: derivatives of a run with dry friction are not available, as the times at which joints stick or "
            "slide change with each number; leave the friction out, or make it viscous",
            s->name);
    return DONE;
}
