#include "fixed.h"

#include "instance.h"
#include "interface_jacobian.h"
#include "interpret.h"
#include "layout.h"
#include "peaks.h"
#include "record.h"
#include "scene.h"
#include "scene_sizes.h"
#include "settings.h"
#include "way.h"

/* Number of internal steps between two calls of `go_on`. */
#define LOOK 64

/* Return whether the caller of a run has ended it. */
int run_is_ended(Instance *i)
{
    if (i->go_on && !i->ended && ++i->looks % LOOK == 0)
        i->ended = !i->go_on(i);
    return i->ended;
}

/* Return whether the last evaluation of outputs serves as the first stage of a quick step. */
int step_can_reuse(const Instance *i)
{
    const Scene *s = i->scene;
    const size_t state = 2 * (size_t)s->n * sizeof *i->m;
    return i->onward && i->flags.known && !memcmp(i->read_at, i->m + s->z, state)
        && !memcmp(i->read_at + 2 * s->n, i->m + s->u, (size_t)s->inputs * sizeof *i->m);
}

/* Return whether the last evaluation of outputs was near a singular position. */
int step_reuse_is_near(const Instance *i)
{
    const Scene *s = i->scene;
    return i->m[s->k + SETTINGS_CONTINUES] != 0.0 && i->workspace[s->read_watch + WATCH_NEAR] != 0.0;
}

/* Commit the step. */
void step_commit(Instance *i)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *begin = s->peaks ? arena_alloc(i, scene_state_length(s)) : NULL;
    if (begin)
        memcpy(begin, i->m + s->z, scene_state_length(s) * sizeof *begin);
    memcpy(i->m + s->z, i->m + s->after, scene_state_length(s) * sizeof *i->m);
    tape_copy(i, i->m + s->z, i->m + s->after, scene_state_length(s));
    settings_count_turns(i);
    if (s->entries)
        jacobian_along(i);
    if (begin)
        peaks_along(i, begin);
    arena_release(i, arena);
}

/* Take internal steps, each by the first tier that succeeds, until one fails at every tier. Return how many were
   taken. */
long step_fixed(Instance *i, long steps, double dt)
{
    const Scene *s = i->scene;
    const int tiers[] = {s->quick, s->careful, s->branch_step};
    double *m = i->m, *after = m + s->after;
    long done;
    m[s->dt] = dt;
    for (done = 0; done < steps && !run_is_ended(i); done++) {
        int tier = m[s->control + CONTROL_TIER] != 0.0;
        const int onward = done == 0 && tier == 0 && s->reuses && !s->method && step_can_reuse(i);
        if (onward && s->branch_step >= 0 && step_reuse_is_near(i))
            tier = 2;
        for (;;) {
            const Mark begin = tape_mark(i);
            if (tier == 2)
                way_update(i);
            i->workspace[s->onward] = onward;
            program_run(i, tiers[tier]);
            if (after[s->trouble] == 0.0)
                break;
            tape_cut(i, begin);
            /* Near a singular position only the branch tier is valid. */
            if (tier == 2 || (tier == 1 && after[s->near] == 0.0))
                return done;
            tier = after[s->near] != 0.0 ? 2 : 1;
            if (tiers[tier] < 0)
                return done;
        }
        step_commit(i);
        m[s->tally + tier] += 1.0;
        i->shared += onward && tier == 0;
        if (tier == 2)
            m[s->tally + TALLY_LIMITS] += after[s->near];
    }
    return done;
}

/* Take a communication step by RK4 in one call. Return 0 and change nothing if this is impossible; `made` is then
   the number of internal steps before the one that failed, -1 if none was tried. */
int step_fixed_whole(Instance *i, double start, double h, long *made)
{
    const Scene *s = i->scene;
    double *m = i->m, *z = m + s->z;
    const double count = settings_internal_steps(i, h);
    double counted[TALLY];
    const size_t state = scene_state_length(s) * sizeof *m, past = (size_t)s->past_size * sizeof *m;
    const Mark begun = tape_mark(i);
    long steps;
    *made = -1;
    if (!(count <= MOST_STEPS))
        return 0;
    steps = (long)count;
    memcpy(m + s->begin, z, state);
    memcpy(counted, m + s->tally, TALLY * sizeof *m);
    memcpy(i->past_before, m + s->past, past);
    instance_set_time(i, start);
    if (s->reach >= 0)
        program_run(i, s->reach);
    *made = step_fixed(i, steps, h / (double)steps);
    if (*made != steps) {
        tape_cut(i, begun);
        memcpy(z, m + s->begin, state);
        settings_count_turns(i);
        memcpy(m + s->tally, counted, TALLY * sizeof *m);
        memcpy(m + s->past, i->past_before, past);
        return 0;
    }
    instance_set_time(i, start + h);
    return 1;
}
