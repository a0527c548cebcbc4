#include "balance.h"

#include "equations.h"
#include "instance.h"
#include "layout.h"
#include "message.h"
#include "record.h"
#include "scene.h"
#include "settings.h"

/* Largest displacement [m, rad] of a communication step that counts as rest if the motion is slow at both ends: a
   hundredth of the default tolerance. */
#define RESTING 1e-8

/* Return whether the last communication step began and ended at rest in the same position. The work of a large force
   is then round-off of the velocities, and there is no energy to compare it with. */
static int is_at_rest(Instance *i, double kinetic)
{
    const Scene *s = i->scene;
    const double *now = instance_field(i, s->z), *begin = instance_field(i, s->begin);
    for (int c = 0; c < scene_coordinates(s); c++)
        if (!(fabs(now[c] - begin[c]) <= RESTING && fabs(now[s->n + c]) <= SLOW_MOTION
                && fabs(begin[s->n + c]) <= SLOW_MOTION))
            return 0;
    /* With prescribed motion, points may move although no coordinate changes. */
    return !s->timed || kinetic <= energy_at_speed(i, SLOW_MOTION);
}

/* Warn of drift where no work is done. A relative error of the energy causes half that error in the rates, and hence
   in the distance travelled. */
static void warn_of_drift(Instance *i)
{
    const Scene *s = i->scene;
    const double *now = instance_field(i, s->z), *begin = instance_field(i, s->begin),
                 h = now[s->time] - begin[s->time];
    double *c = i->counts, rate = 0.0;
    if (now[s->work] != 0.0)
        return;
    for (int k = 0; k < scene_coordinates(s); k++)
        rate = fmax(rate, (fabs(now[s->n + k]) + fabs(begin[s->n + k])) / 2);
    c[DRIFT] += c[BALANCE] / c[ENERGY_SCALE] / 2 * rate * h;
    if (fabs(c[DRIFT]) > UNBALANCED)
        instance_warn(i, WARNED_OF_DRIFT,
            "%s, t = %.6g s: the drift of energy has put the motion off by about %.1g rad (or m), and its error "
            "grows; %s, and check the run with --check",
            s->name, now[s->time], fabs(c[DRIFT]),
            settings_method(i) == 1 ? "take a smaller solver.relative_tolerance" : "take shorter steps");
}

/* Update the energy balance after a communication step, if a monitor reads it. */
void instance_balance(Instance *i)
{
    const Scene *s = i->scene;
    const double *z = instance_field(i, s->z), work = z[s->work];
    double *c = i->counts, found, kinetic, off;
    if (!s->balances)
        return;
    found = energy_evaluate(i, z + s->n, &kinetic);
    off = found - c[ENERGY_START] - work - c[AT_REST];
    if (is_at_rest(i, kinetic) || (kinetic == 0.0 && found == c[ENERGY_START])) { /* as in statics without mass */
        c[AT_REST] += off - c[BALANCE];
        off = c[BALANCE];
    }
    c[ENERGY_SCALE] = fmax(c[ENERGY_SCALE], fmax(kinetic, fabs(work)));
    c[STEP_ERROR] = fabs(off - c[BALANCE]) / c[ENERGY_SCALE];
    c[BALANCE] = off;
    c[RUN_ERROR] = fmax(c[RUN_ERROR], fabs(off) / c[ENERGY_SCALE]);
    warn_of_drift(i);
    if (!(c[RUN_ERROR] <= UNBALANCED))
        instance_warn(i, WARNED_OF_BALANCE,
            "%s, t = %.6g s: the energy balance is off by %.2g of the energy of the motion; %s", s->name,
            z[s->time], c[RUN_ERROR],
            settings_method(i) == 1 && *i->freedom <= 0.0 ? "the motion is prescribed, and tolerances control its work "
                                                            "only in steps above solver.step_size: "
                                                            "take shorter communication steps"
                : settings_method(i) == 1       ? "use a smaller solver.relative_tolerance"
                : s->l && !settings_continue(i) ? "near singular positions solver.formulation residual with "
                                                  "solver.branch continue keeps it; elsewhere take "
                                                  "a smaller solver.step_size"
                                                : "steps of solver.step_size are too long: take shorter ones, or "
                                                  "solver.method explicit or stiff, which "
                                                  "control their error");
}

/* Compute the change of the energy balance in the last communication step, if a monitor reads it. */
void balance_tell_step_error(Instance *i)
{
    const Scene *s = i->scene;
    double *step_error = i->m + s->seen + s->monitor_step_error;
    if (s->monitor_step_error >= 0) {
        *step_error = i->counts[STEP_ERROR];
        tape_clearing(i, step_error, 1);
    }
}
