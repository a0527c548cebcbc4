#include "topology.h"

#include "balance.h"
#include "equations.h"
#include "friction.h"
#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "masses.h"
#include "message.h"
#include "peaks.h"
#include "record.h"
#include "scene.h"
#include "settings.h"

/* Largest |Phi-dot| after an impact, in units of its row, above which the constraints in force contradict each
   other: a thousand times the limit after a step. */
#define CONTRADICTION 1e-3

/* Warn that dry friction took no part in an impact whose energy loss [J] is large enough for the energy balance. */
static void warn_of_impact(Instance *i, const double *v, double lost)
{
    const Scene *s = i->scene;
    double kinetic;
    energy_evaluate(i, v, &kinetic);
    if (lost > UNBALANCED * fmax(kinetic + lost, fabs(energy_at_speed(i, SLOW_MOTION))))
        instance_warn(i, WARNED_OF_IMPACT,
            "%s, t = %.6g s: an impact took %.3g J without a share of dry friction: impulses in joints with dry "
            "friction, such as %s, cause no friction",
            s->name, *instance_time(i), lost, s->rows[s->friction[0].row].name);
}

/* Replace the constraints in force. New ones must be closed; an impact makes the velocities consistent with them. */
Outcome topology_change(Instance *i, const double *on)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *q = instance_field(i, s->z), *v = q + s->n, *w = i->workspace, *work = q + s->work, gap;
    double *energies = arena_alloc(i, 4);
    unsigned char *held = (unsigned char *)arena_alloc(i, (size_t)s->l),
                  *new = (unsigned char *)arena_alloc(i, (size_t)s->l);
    char label[100];
    int row, any = 0;
    Outcome outcome;
    settings_in_force(i, on, held);
    for (int r = 0; r < s->l; r++) {
        const int before = i->penalty[r] > 0.0;
        i->penalty[r] = held[r] ? i->full[r] : 0.0;
        held[r] = i->penalty[r] > 0.0;
        new[r] = held[r] && !before;
        any |= new[r];
    }
    settings_set_penalties(i);
    gap = constraints_widest(i, q, v, 0, &row);
    if (!(gap <= GROSS))
        outcome = instance_say(i, REFUSED,
            "%s, t = %.6g s: a constraint that is open by %.3g at %s cannot be switched on; wait until it closes",
            s->name, *instance_time(i), gap, instance_row_label(i, row, label, sizeof label));
    else
        outcome = masses_check(i, q, held);
    if (outcome == DONE && any) {
        const double *lost[] = {work, w + s->lost}, factors[] = {1.0, 1.0}, once_less[] = {1.0, -1.0};
        if (s->timed)
            energy_record(i, v, energies);
        program_run(i, s->impact);
        memcpy(v, w + s->struck, (size_t)s->n * sizeof *v);
        tape_copy(i, v, w + s->struck, (size_t)s->n);
        if (s->timed) /* A prescribed motion that comes into force also does work. */
            energy_add_jump(i, energies);
        else {
            *work += -w[s->lost];
            tape_sum(i, work, 2, lost, once_less);
        }
        *i->dissipated += w[s->lost];
        lost[0] = i->dissipated;
        tape_sum(i, i->dissipated, 2, lost, factors);
        for (int k = 0; k < s->impulses; k++)
            if (new[s->impulse_rows[k]]) {
                i->impulses[k] = w[s->impulse + s->impulse_rows[k]];
                tape_copy(i, i->impulses + k, w + s->impulse + s->impulse_rows[k], 1);
            }
        if (s->frictions)
            warn_of_impact(i, v, w[s->lost]);
        gap = constraints_widest(i, q, v, 1, &row);
        if (!(gap <= CONTRADICTION))
            outcome = instance_say(i, REFUSED,
                "%s, t = %.6g s: the lock, joint or motion switched on contradicts those in force: no velocities "
                "satisfy both, as %s is violated by %.3g per second; switch one of them off",
                s->name, *instance_time(i), instance_row_label(i, row, label, sizeof label), gap);
    }
    if (outcome == DONE)
        outcome = settings_update_rank(i, q, v);
    if (outcome == DONE)
        settings_upload(i);
    i->flags.known = 0;
    arena_release(i, arena);
    return outcome;
}

/* Apply the requested Boolean inputs at this instant. */
Outcome topology_take_effect(Instance *i)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    Outcome outcome;
    peaks_broken(i);
    if (s->held) {
        double *displacements = arena_alloc(i, (size_t)s->held);
        const double *x[] = {instance_field(i, s->z), instance_field(i, s->p)};
        double *y[] = {displacements};
        function_call_recorded(i, s->displacements, x, y);
        for (int k = 0; k < s->switches; k++)
            if (s->switched[k].value >= 0 && i->requested[k] != 0.0 && i->active[k] == 0.0) {
                i->discrete[s->switched[k].value] = displacements[s->switched[k].value];
                tape_copy(i, i->discrete + s->switched[k].value, displacements + s->switched[k].value, 1);
            }
        settings_upload_parameters(i);
    }
    if (s->frictions) {
        friction_reset(i); /* Friction takes no part in an impact; sticking joints are determined after it. */
        settings_upload_parameters(i);
    }
    outcome = topology_change(i, i->requested);
    if (outcome == DONE)
        outcome = friction_begin(i);
    if (outcome == DONE)
        memcpy(i->active, i->requested, (size_t)s->switches * sizeof *i->active);
    i->flags.pending = 0;
    arena_release(i, arena);
    return outcome;
}
