/* Steps with fixed iteration counts only: a step for which the kernel's tiers do not suffice fails. */

#include "robust.h"

Outcome step_robust(Instance *i, double start, double dt)
{
    return instance_say(i, FAILED, "%s, t = %.6g s: a step of %g s needs more iterations than this FMU contains; "
                                   "reduce solver.step_size, or export it as --kind native", i->scene->name, start, dt);
}

Outcome step_rk4(Instance *i, double start, double dt)
{
    i->left--;
    if (i->flags.brakes)
        rank_freeze(i);
    return i->flags.fast && step_fixed(i, 1, dt) == 1 ? DONE : step_robust(i, start, dt);
}

Outcome step_adaptive_to(Instance *i, double end, double dt, int once)
{
    (void)once;
    return step_robust(i, end, dt);
}
