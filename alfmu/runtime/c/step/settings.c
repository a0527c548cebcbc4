/* Settings of a run (formulation, integrator, tolerances, penalties), passed to the programs of the scene. */

#include "settings.h"

#include "calibration.h"
#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "linear.h"
#include "message.h"
#include "rank.h"
#include "record.h"
#include "scene.h"
#include "scene_sizes.h"
#include "text.h"

/* Return the program that evaluates the outputs by loops that stop on convergence. */
int settings_instant(const Scene *s)
{
    return s->instant_patient < 0 ? s->instant : s->instant_patient;
}

int settings_formulation(const Instance *i)
{
    return i->flags.choice[i->scene->formulation];
}

/* Return whether steps end with projections (10). */
int settings_project(const Instance *i)
{
    static const int usual[] = {PROJECTED};
    return *i->projection < 0.0 ? usual[settings_formulation(i)] : *i->projection > 0.0;
}

/* Return whether all programs support the chosen formulation, not only `move`, `close` and `instant_patient`. */
int settings_all_serve(const Instance *i)
{
    return !i->scene->l || (settings_formulation(i) == RESIDUAL_FORMULATION && settings_project(i));
}

/* Return whether the penalty is given instead of scaled with the masses. */
int penalty_is_given(const Instance *i)
{
    return i->values[i->scene->penalty] > 0.0 || i->flags.given;
}

/* Return a further remedy for a failure. */
const char *settings_or_penalty(const Instance *i)
{
    if (penalty_is_given(i))
        return "; or solver.penalty 0, which scales it with the masses";
    if (!i->scene->limit_count)
        return "";
    return "; or leave out end stops, those of a file by its option limits=ignore, or start within them, by "
           "limits=inside";
}

/* Return a further remedy if compliances that share loads differ too much for the available iterations. */
const char *settings_or_compliances(const Instance *i, char *text, size_t size)
{
    double least = INFINITY;
    *text = '\0';
    for (int r = 0; r < i->scene->compliances; r++)
        least = fmin(least, i->compliances[r]);
    if (least > 0.0 && least < INFINITY)
        write_text(text, size,
            "; or compliances of constraints that are closer together (they differ by a factor of %.1g)",
            linear_largest(i->compliances, i->scene->compliances) / least);
    return text;
}

/* Return the least number of internal steps in a communication step, to round-off of its length. */
double settings_internal_steps(const Instance *i, double h)
{
    return fmax(1.0, ceil(h / i->values[i->scene->step_size] * (1 - 1e-12)));
}

/* Return whether a step has been taken, so that its length may be the cause of a failure. */
int settings_moving(const Instance *i)
{
    const double *tally = i->m + i->scene->tally;
    double made = i->counts[PATIENT_STEPS] + tally[TALLY_COVERED];
    for (int tier = TALLY_QUICK; tier <= TALLY_BRANCH; tier++)
        made += tally[tier];
    return made > 0.0;
}

/* Return the remedy for errors that shorter steps may reduce. */
const char *settings_or_shorter(const Instance *i)
{
    if (i->flags.mode)
        return "let the importer take shorter steps, or use its solver with error control";
    return settings_moving(i) ? "reduce solver.step_size" : "check forces, dimensions and start values";
}

/* Return the remedy for a loop that ends before it converges. */
const char *settings_remedy(const Instance *i)
{
    return penalty_is_given(i) ? "use solver.penalty 0, which scales it with the masses" : settings_or_shorter(i);
}

/* Set the arguments of programs that are not part of the memory. Inputs stand still, except in a step. */
void settings_upload_arguments(Instance *i)
{
    const Scene *s = i->scene;
    const double iterations = i->values[s->max_iterations];
    const int formulation = settings_formulation(i);
    int other = RESIDUAL_FORMULATION;
    i->workspace[s->most] = fmax(iterations - 1, 1.0);
    i->workspace[s->patient] = PATIENT * iterations - 1;
    i->workspace[s->again] = iterations - 1;
    memcpy(i->workspace + s->stabilisation, i->stabilisation, 2 * sizeof(double));
    i->workspace[s->projects] = settings_project(i);
    i->workspace[s->of_least_norm] = formulation == RESIDUAL_FORMULATION || settings_project(i);
#define CHOOSE(name) i->workspace[s->name] = formulation == ++other;
    SCENE_OTHERS(CHOOSE)
#undef CHOOSE
    i->workspace[s->on_branch] = i->workspace[s->onward] = 0.0;
    memset(i->workspace + s->slopes, 0, (size_t)(s->inputs + 1) * sizeof(double));
    if (s->reach >= 0)
        i->workspace[s->within] = i->within;
}

/* Pass penalties, units and load shares of the constraints to the kernel; no rank is frozen. */
void settings_set_penalties(Instance *i)
{
    const Scene *s = i->scene;
    double *k = instance_field(i, s->k), *rows = k + SETTINGS, most = linear_largest(i->penalty, s->l),
           least = INFINITY;
    double *shares = rows + 2 * s->l + s->n, *matrix = k + scene_matrix(s);
    *i->largest_penalty = most = most > 0.0 ? most : 1.0;
    k[SETTINGS_ALPHA] = most;
    k[SETTINGS_TOLERANCE] = i->values[s->tolerance];
    for (int r = 0; r < s->l; r++) {
        rows[r] = i->penalty[r] / most;
        rows[s->l + r] = 1 / i->units[r];
        for (int c = 0; s->brakes && c < s->l; c++)
            matrix[r * s->l + c] = r == c ? rows[r] : 0.0;
    }
    if (s->brakes)
        tape_clearing(i, matrix, (size_t)s->l * (size_t)s->l);
    for (int r = 0; r < s->compliances; r++)
        least = fmin(least, i->compliances[r]);
    for (int r = 0; r < s->compliances; r++)
        shares[r] = least > 0.0 ? (i->penalty[r] > 0.0) * least / i->compliances[r] : rows[r];
}

/* Return whether a motion follows its branch near a singular position. */
int settings_continue(const Instance *i)
{
    return settings_all_serve(i) && i->flags.choice[i->scene->branch] == i->scene->continues;
}

/* Return the integrator: 0 RK4, 1 the scene's integrator with error control, 2 the same with fixed steps. The
   integrator that `auto` selects supports one formulation only and follows the branch through singular positions. */
int settings_method(const Instance *i)
{
    const Scene *s = i->scene;
    const int rk4
        = i->flags.choice[s->method_choice] == s->rk4_choice || (s->automatic && s->l && !settings_continue(i));
    return rk4 ? 0 : s->method;
}

/* Return the tolerance of a step from that of the run: proportional for explicit integrators, less above STEADY. */
static double step_tolerance(double share, double exponent, double run)
{
    return share * pow(run, exponent) * (exponent == 1.0 ? pow(fmin(1.0, STEADY / run), LOOSER) : 1.0);
}

/* Pass the settings to the kernel. */
void settings_upload(Instance *i)
{
    const Scene *s = i->scene;
    double *k = instance_field(i, s->k), *rows = k + SETTINGS, *control = instance_field(i, s->control);
    const double relative = i->values[s->relative_tolerance], absolute = i->values[s->absolute_tolerance];
    settings_set_penalties(i);
    k[SETTINGS_AGREED] = *i->agreed;
    k[SETTINGS_FREEDOM] = *i->freedom;
    k[SETTINGS_MASSES] = *i->masses;
    k[SETTINGS_REGULAR] = *i->regular;
    k[SETTINGS_NOTHING] = NOISE_FLOOR * *i->least_margin;
    k[SETTINGS_LEAST_DISTANCE] = fmax(LEAST_DISTANCE, CONVERGENCE * sqrt(*i->least_margin));
    k[SETTINGS_CONTINUES] = s->l && settings_continue(i);
    k[SETTINGS_RELATIVE] = s->method ? step_tolerance(s->share, s->exponent, relative) : 0.0;
    k[SETTINGS_ABSOLUTE]
        = s->method ? step_tolerance(s->share, s->exponent, absolute > 0.0 ? absolute : relative) : 0.0;
    k[SETTINGS_ABSOLUTE_LENGTH] = k[SETTINGS_ABSOLUTE] * *i->length;
    k[SETTINGS_INVERSE_LENGTH] = 1 / *i->length;
    k[SETTINGS_INVERSE_LOOP] = 1 / *i->loop;
    k[SETTINGS_BESIDE] =
        s->method == 1 ? step_tolerance(s->beside_share, s->beside_exponent, relative) / k[SETTINGS_RELATIVE] : 1.0;
    k[SETTINGS_SHORT] = s->method == 1 ? s->short_share * pow(relative, s->short_exponent) / k[SETTINGS_RELATIVE] : 0.0;
    k[SETTINGS_STIFF] =
        s->method == 1 ? step_tolerance(s->stiff_share, s->stiff_exponent, relative) / k[SETTINGS_RELATIVE] : 1.0;
    for (int c = 0; c < s->n; c++)
        rows[2 * s->l + c] = *i->largest_penalty / (s->l ? i->scales[c] : 1.0);
    instance_field(i, s->dt)[0] = control[CONTROL_STEP_SIZE] = i->values[s->step_size];
    control[CONTROL_TIER] = !(i->flags.scaled || s->same_tiers);
    control[CONTROL_METHOD] = settings_method(i);
    i->flags.fast = !s->l || (settings_all_serve(i) && i->values[s->max_iterations] >= s->careful_iterations);
    i->flags.whole = i->flags.fast && !i->flags.brakes;
    if (i->flags.brakes)
        rank_freeze(i);
}

/* Take the present angles as the reference from which turns are counted. Nothing but turn counts depends on them. */
void settings_count_turns(Instance *i)
{
    const Scene *s = i->scene;
    const int behind = s->counted + (s->timed ? 1 + s->followed_count * POLYNOMIAL : 0);
    if (s->counted)
        memcpy(instance_field(i, s->p) + s->own + s->held - behind, instance_field(i, s->z) + s->work - s->counted,
            (size_t)s->counted * sizeof(double));
}

/* Update the angles that places tell up to whole turns, by a step of length zero. Scenes without steps keep those of
   the start values, from which analyses count. */
void settings_follow_turns(Instance *i)
{
    const Scene *s = i->scene;
    double *z = instance_field(i, s->z);
    const double *after = instance_field(i, s->after);
    const int still = s->l ? s->close : s->careful;
    if (!s->angles || still < 0 || !s->programs[still].words)
        return;
    i->m[s->dt] = 0.0;
    memcpy(i->workspace + s->q, z, (size_t)s->n * sizeof *z);
    memcpy(i->workspace + s->v, z + s->n, (size_t)s->n * sizeof *z);
    program_run(i, still);
    memcpy(z + 2 * s->n, after + 2 * s->n, (size_t)s->angles * sizeof *z);
    settings_count_turns(i);
    i->m[s->dt] = i->values[s->step_size];
}

void settings_upload_parameters(Instance *i)
{
    const Scene *s = i->scene;
    double *p = instance_field(i, s->p);
    memcpy(p, i->values, (size_t)s->own * sizeof *p);
    memcpy(p + s->own, i->discrete, (size_t)s->held * sizeof *p);
    tape_copy(i, p, i->values, (size_t)s->own);
    tape_copy(i, p + s->own, i->discrete, (size_t)s->held);
    settings_count_turns(i);
}

void settings_in_force(const Instance *i, const double *on, unsigned char *held)
{
    const Scene *s = i->scene;
    memset(held, 1, (size_t)s->l);
    for (int k = 0; k < s->switches; k++)
        for (int r = 0; r < s->switched[k].count; r++)
            held[s->switched[k].rows[r]] = (on[k] != 0.0) == s->switched[k].holds;
    for (int k = 0; k < s->frictions; k++)
        held[s->friction[k].row] = i->discrete[s->friction[k].slip] == 0.0;
}

/* Return whether the constraints in force are those with all Boolean inputs off and no joint sticking. */
int settings_usual(Instance *i)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    unsigned char *held = (unsigned char *)arena_alloc(i, (size_t)s->l);
    double *off = arena_alloc(i, (size_t)s->switches);
    int same = 1;
    memset(off, 0, (size_t)s->switches * sizeof *off);
    settings_in_force(i, off, held);
    for (int k = 0; k < s->frictions; k++)
        held[s->friction[k].row] = 0;
    for (int r = 0; r < s->l; r++)
        same &= (i->penalty[r] > 0.0) == held[r];
    arena_release(i, arena);
    return same;
}

const char *settings_method_name(const Instance *i)
{
    const Scene *s = i->scene;
    return s->choice[s->method_choice].values[i->flags.choice[s->method_choice]];
}

double settings_margin(Instance *i, const double *q)
{
    double found = 1.0;
    const double *x[] = {q, instance_field(i, i->scene->p), instance_field(i, i->scene->k)};
    double *y[] = {&found};
    if (i->scene->margin >= 0)
        function_call(i, i->scene->margin, x, y);
    return found;
}

/* Determine ranks and scales of the constraints in force at q and v. */
Outcome settings_update_rank(Instance *i, const double *q, const double *v)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    unsigned char *held = (unsigned char *)arena_alloc(i, (size_t)s->l);
    Outcome outcome = DONE;
    for (int r = 0; r < s->l; r++)
        held[r] = i->penalty[r] > 0.0;
    *i->freedom = s->n;
    *i->masses = 0.0;
    *i->least_margin = 1.0;
    if (s->l)
        calibration_find(i, q, v, held, settings_usual(i));
    if (i->flags.brakes && !s->brakes)
        outcome = instance_say(i, RANK_CHANGES,
            "%s: with these parameters redundant constraints would brake the motion, and the scene is not traced for "
            "them; export it with these parameters (--set)",
            s->name);
    arena_release(i, arena);
    return outcome;
}
