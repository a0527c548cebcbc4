#include "projection.h"

#include "equations.h"
#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "message.h"
#include "record.h"
#include "scene.h"
#include "settings.h"

/* Return whether |Phi|, or |Phi-dot| at velocities v, of every row in force is within its limit. */
int projection_is_closed(Instance *i, const double *residue, const double *C, const double *q, const double *v)
{
    const size_t arena = arena_mark(i);
    double *limits = arena_alloc(i, (size_t)i->scene->l);
    int all = 1;
    constraints_limits(i, C, q, v, limits);
    for (int r = 0; r < i->scene->l; r++)
        all &= !(i->penalty[r] > 0.0) || fabs(residue[r]) <= limits[r];
    arena_release(i, arena);
    return all;
}

/* Project q and v onto the constraints. */
Outcome projection_apply(Instance *i, double *q, double *v)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), l = (size_t)s->l, n = (size_t)s->n;
    double *C = arena_alloc(i, (size_t)s->constraint.entries), *phi = arena_alloc(i, l), *cv = arena_alloc(i, l),
           *next = arena_alloc(i, n);
    double pivot, left[2];
    const double *x[] = {q, instance_field(i, s->p), instance_field(i, s->k)},
                 *at[] = {q, v, instance_field(i, s->p), instance_field(i, s->k)};
    double *y[] = {next}, *settled[] = {next, &pivot, left};
    char label[100];
    Outcome outcome = DONE;
    for (int pass = 0; pass < CORRECTIONS; pass++) {
        constraints_evaluate(i, q, v, NULL, C, phi, cv);
        if (projection_is_closed(i, phi, C, q, NULL))
            break;
        function_call_recorded(i, s->place, x, y);
        memcpy(q, next, n * sizeof *q);
        tape_copy(i, q, next, n);
    }
    for (int pass = 0; pass < CORRECTIONS; pass++) {
        constraints_evaluate(i, q, v, NULL, C, phi, cv);
        if (projection_is_closed(i, cv, C, q, v))
            break;
        function_call_recorded(i, s->settle, at, settled);
        memcpy(v, next, n * sizeof *v);
        tape_copy(i, v, next, n);
    }
    for (int of_velocity = 0; of_velocity < 2 && outcome == DONE; of_velocity++) {
        int row;
        const double worst = constraints_widest(i, q, v, of_velocity, &row);
        if (!(worst <= GROSS))
            outcome = instance_say(i, CONSTRAINT_OPEN,
                "%s, t = %.6g s: %s = %.1e at %s > %.0e after %d corrections; %s", s->name, *instance_time(i),
                of_velocity ? "|Phi-dot|" : "|Phi|", worst, instance_row_label(i, row, label, sizeof label), GROSS,
                CORRECTIONS, settings_remedy(i));
    }
    arena_release(i, arena);
    return outcome;
}

/* Project q and v in the workspace onto the constraints. */
Outcome projection_close(Instance *i, double t)
{
    const Scene *s = i->scene;
    const double *after = instance_field(i, s->after);
    char label[100];
    int row;
    program_run(i, s->close);
    for (int of_velocity = 0; of_velocity < 2; of_velocity++) {
        const double worst = constraints_widest(i, after, after + s->n, of_velocity, &row);
        if (!(worst <= GROSS))
            return instance_say(i, CONSTRAINT_OPEN,
                "%s, t = %.6g s: %s = %.1e at %s > %.0e after %d corrections; %s", s->name, t,
                of_velocity ? "|Phi-dot|" : "|Phi|", worst, instance_row_label(i, row, label, sizeof label), GROSS,
                CORRECTIONS, settings_remedy(i));
    }
    return DONE;
}

/* Update the largest |Phi| and |Phi-dot| after a step without projections. */
void projection_watch_gaps(Instance *i)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), l = (size_t)s->l;
    const double *q = instance_field(i, s->after);
    double *phi = arena_alloc(i, l), *cv = arena_alloc(i, l), *c = i->counts;
    constraints_evaluate(i, q, q + s->n, NULL, NULL, phi, cv);
    for (int r = 0; r < s->l; r++)
        if (i->penalty[r] > 0.0) {
            c[POSITION_ERROR] = fmax(c[POSITION_ERROR], fabs(phi[r]));
            c[VELOCITY_ERROR] = fmax(c[VELOCITY_ERROR], fabs(cv[r]));
        }
    arena_release(i, arena);
}
