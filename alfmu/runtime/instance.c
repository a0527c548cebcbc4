/* Values, communication steps, events, outputs and the state of an instance, as instance.py has them. */

#include "alfmu.h"
#include "tape.h"
#include "text.h"

#include <assert.h>
#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define FORMAT 8
#define MAGIC 0x464d4c41u /* "ALMF" */

/* As many of them as a patient step, whose loops stop on convergence, takes the time of. */
#define PATIENT_STEP 10

/* Velocities [m/s, rad/s] of a motion whose energy is too little to judge a balance by. */
#define SLOW_MOTION 1e-5

/* Displacement [m, rad] of a communication step, between ends at which the motion is as slow, that is rest: a hundredth of
   the default tolerance. */
#define RESTING 1e-8

/* What an impact leaves of Phi-dot, in units of its row, where no velocities serve all constraints in force: a thousand times
   what a step may leave. */
#define CONTRADICTION 1e-3

/* Share of a direction of inputs by which outputs are changed for a difference, where they do not change evenly. */
#define SMALL_CHANGE 1e-4

/* Inputs above this are tried before they are taken: some outputs may not be finite with them. */
#define TRIED 1e30

/* Memory ----------------------------------------------------------------------------------------------------------- */

double *field(const Instance *i, int offset)
{
    return i->m + offset;
}

/* One of the numbers that what can be read ends with. */
double verdict(const Instance *i, int which)
{
    return i->m[i->scene->seen + i->scene->seen_size - SEEN + which];
}

double *instance_time(Instance *i)
{
    return i->m + i->scene->z + i->scene->time;
}

/* The state at a time, which is also the last coordinate where places depend on it. */
void at_time(Instance *i, double time)
{
    const Scene *s = i->scene;
    *instance_time(i) = time;
    if (s->timed)
        field(i, s->z)[s->n - 1] = time;
}

/* Coordinates without time. */
int dependent(const Scene *s)
{
    return s->n - s->timed;
}

double *take(Instance *i, size_t count)
{
    double *taken = i->scratch + i->used;
    i->used += count;
    assert(i->used <= i->room);
    return taken;
}

/* Points the parts at their places behind each other, and returns how many numbers they take. */
static size_t divided(Instance *i, double *numbers)
{
    const Scene *s = i->scene;
    size_t count = 0;
    const struct {
        double **part;
        int size;
    } parts[] = {
        {&i->values, s->parameters},
        {&i->wanted, s->switches},
        {&i->on, s->switches},
        {&i->kept, s->held},
        {&i->heard, s->followed_count * HEARD},
        {&i->impulses, s->impulses},
        {&i->lost, 1},
        {&i->slopes, s->inputs + 1},
        {&i->penalty, s->l},
        {&i->full, s->l},
        {&i->units, s->l},
        {&i->scales, s->n},
        {&i->compliances, s->compliances},
        {&i->freedom, 1},
        {&i->masses, 1},
        {&i->regular, 1},
        {&i->rank, 1},
        {&i->largest_penalty, 1},
        {&i->length, 1},
        {&i->peaks, (int)peaks_length(s)},
        {&i->jacobian, s->entries},
        {&i->given, s->l},
        {&i->counts, COUNTED},
        {&i->stabilisation, 2},
        {&i->projection, 1},
        {&i->m, s->size},
    };
    for (size_t k = 0; k < sizeof parts / sizeof *parts; k++) {
        if (numbers)
            *parts[k].part = numbers + count;
        count += (size_t)parts[k].size;
    }
    return count;
}

Instance *instance_new(const Scene *s)
{
    const size_t side = (size_t)(s->n + s->l + s->ties + 1);
    Instance *i = calloc(1, sizeof *i);
    double *numbers;
    if (!i)
        return NULL;
    i->scene = s;
    i->count = divided(i, NULL);
    /* Matrices of the start that singular values are found of are dense, others sparse. */
    i->room = (s->n <= DENSE ? 12 * side * side : 0) + (size_t)64 * side + s->closing.entries + s->holding.entries
        + 16 * (size_t)(s->mass.entries + s->constraint.entries + s->gaps.entries + s->tie_rows.entries)
        + 4 * (size_t)(driven_by(s) + s->outputs) + (size_t)(s->past + s->past_size - s->pace);
    i->room += laws_room(s) + breaks_room(s) + peaks_room(s) + (size_t)s->limit_count * (2 + (size_t)s->n);
    if (s->frictions) /* What steps up to events remember. */
        i->room += (size_t)(18 * s->frictions + 2 * s->held + s->past + s->past_size - s->pace) + state_length(s) + peaks_length(s);
    /* The workspace of programs stands behind the memory, which is the last of the numbers. */
    numbers = calloc(2 * i->count + (size_t)s->workspace + i->room + (size_t)s->registers
            + LANES * ((size_t)s->lane_registers + 1) + (size_t)s->spare + (size_t)s->past_size + (size_t)(s->held + s->followed_count * HEARD) + least_norm_work(s->dense, s->dense)
            + 2 * (size_t)s->n + (size_t)s->inputs + (s->break_count ? 2 * MOST_BREAKS : 0),
        sizeof *numbers);
    if (!numbers) {
        free(i);
        return NULL;
    }
    i->numbers = numbers;
    divided(i, numbers);
    i->workspace = numbers + i->count;
    i->before = i->workspace + s->workspace;
    i->scratch = i->before + i->count;
    i->registers = i->scratch + i->room;
    i->lanes = lanes_from(i->registers + s->registers);
    i->spare = i->lanes + LANES * (size_t)s->lane_registers;
    i->past_before = i->spare + s->spare;
    i->kept_before = i->past_before + s->past_size;
    i->dense = i->kept_before + s->held + s->followed_count * HEARD;
    i->read_at = i->dense + least_norm_work(s->dense, s->dense);
    i->breaks = i->read_at + 2 * s->n + s->inputs;
    registers_begin(i);
    instance_reset(i);
    return i;
}

void instance_free(Instance *i)
{
    if (i) {
        gradient_free(i->gradient);
        gradient_free(i->of_step);
        free(i->numbers);
        free(i);
    }
}

void instance_reset(Instance *i)
{
    const Scene *s = i->scene;
    const Variable *v = s->variables;
    memset(i->numbers, 0, i->count * sizeof *i->numbers);
    memset(&i->flags, 0, sizeof i->flags);
    i->flags.phase = INSTANTIATED;
    i->stop = INFINITY;
    i->stabilisation[0] = ZETA;
    i->stabilisation[1] = OMEGA;
    *i->projection = -1.0;
    *i->length = 1.0;
    for (int k = 0; k < s->parameters; k++)
        i->values[k] = v[k].start;
    v += s->parameters;
    for (int k = 0; k < s->choices; k++)
        i->flags.choice[k] = s->choice[k].start;
    v += s->choices;
    for (int k = 0; k < s->inputs; k++) {
        i->m[s->u + k] = v[k].start;
        i->slopes[1 + k] = s->no_slope;
    }
    for (int k = 0; k < s->switches; k++)
        i->wanted[k] = s->switched[k].start;
}

Outcome say(Instance *i, Outcome outcome, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    write_list(i->text, sizeof i->text, format, arguments);
    va_end(arguments);
    return outcome;
}

/* Says something that the host should know, once in a run. */
void warn(Instance *i, int of, const char *format, ...)
{
    va_list arguments;
    size_t used;
    if (i->flags.warned & of)
        return;
    if (i->warns) /* Behind one that nobody has read yet. */
        strncat(i->warning, "; ", sizeof i->warning - strlen(i->warning) - 1);
    else
        *i->warning = '\0';
    i->flags.warned |= of;
    i->warns = 1;
    used = strlen(i->warning);
    va_start(arguments, format);
    write_list(i->warning + used, sizeof i->warning - used, format, arguments);
    va_end(arguments);
}

/* Values ----------------------------------------------------------------------------------------------------------- */

/* DONE, or why a value cannot be that of a variable. */
static Outcome checked(Instance *i, const Variable *v, double value)
{
    const char *name = i->scene->name;
    char low[32] = "-inf", high[32] = "inf";
    if (v->type == BOOLEAN) {
        if (value == 0.0 || value == 1.0)
            return DONE;
        return say(i, REFUSED, "%s: %s is %g; it must be true or false", name, v->name, value);
    }
    if (!isfinite(value))
        return say(i, REFUSED, "%s: %s is %g; it must be a finite number in %s", name, v->name, value, v->unit);
    if (v->type == INTEGER && value != floor(value))
        return say(i, REFUSED, "%s: %s is %g; it must be a whole number", name, v->name, value);
    if (value >= v->minimum && value <= v->maximum)
        return DONE;
    if (isfinite(v->minimum))
        write_text(low, sizeof low, "%g", v->minimum);
    if (isfinite(v->maximum))
        write_text(high, sizeof high, "%g", v->maximum);
    return say(i, REFUSED, "%s: %s = %g %s is outside [%s, %s]", name, v->name, value, v->unit, low, high);
}

/* Whether a parameter can still be changed. */
static Outcome open_to_change(Instance *i, const Variable *v)
{
    if (i->flags.phase & RUN)
        return say(i, REFUSED, "%s: %s is fixed once the run has begun; set it before initialising", i->scene->name,
            v->name);
    i->flags.initialized = 0;
    return DONE;
}

/* What the start depends on may have changed: until the run has begun, it is made again when it is asked for. */
static void start_again(Instance *i, int changed)
{
    if (changed && !(i->flags.phase & RUN))
        i->flags.initialized = 0;
}

static Outcome set_choice(Instance *i, int reference, double value)
{
    const Scene *s = i->scene;
    const Choice *choice = s->choice + (reference - s->parameters);
    char known[400] = "";
    Outcome outcome;
    if (value >= 1.0 && value <= choice->count && value == floor(value)) {
        outcome = open_to_change(i, s->variables + reference);
        if (outcome == DONE)
            i->flags.choice[reference - s->parameters] = (int)value - 1;
        return outcome;
    }
    for (int k = 0; k < choice->count; k++) {
        char part[64];
        snprintf(part, sizeof part, "%s%d (%.40s)", k ? ", " : "", k + 1, choice->values[k]);
        strncat(known, part, sizeof known - strlen(known) - 1);
    }
    return say(i, REFUSED, "%s: %s is %g; this native FMU knows %s", s->name, s->variables[reference].name, value, known);
}

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
        start_again(i, value != u_before || slope_before != s->no_slope);
        return DONE;
    }
    *u = u_before;
    *slope = slope_before;
    return say(i, REFUSED, "%s: %s = %g %s: outputs are not finite with it; give a smaller value", s->name,
        s->variables[reference].name, value, s->variables[reference].unit);
}

static Outcome set_switch(Instance *i, int reference, double value)
{
    const Scene *s = i->scene;
    double *wanted = i->wanted + (reference - s->parameters - s->choices - s->inputs);
    start_again(i, value != *wanted);
    *wanted = value;
    i->flags.pending = 0;
    for (int k = 0; k < s->switches; k++)
        i->flags.pending |= i->wanted[k] != i->on[k];
    return DONE;
}

/* A choice is set by its number, from 1 on. A value that is refused leaves the one before it in force. */
Outcome instance_set(Instance *i, int reference, double value)
{
    const Variable *v = i->scene->variables + reference;
    Outcome outcome;
    if (v->kind == OUTPUT)
        return say(i, REFUSED, "%s: %s is an output and cannot be set", i->scene->name, v->name);
    if (v->kind == CHOICE)
        return set_choice(i, reference, value);
    outcome = checked(i, v, value);
    if (outcome != DONE)
        return outcome;
    if (v->kind == INPUT)
        return set_input(i, reference, value);
    if (v->kind == SWITCH)
        return set_switch(i, reference, value);
    outcome = open_to_change(i, v);
    if (outcome == DONE)
        i->values[reference] = value;
    return outcome;
}

/* zeta and omega [1/s] of (5), (6) and Baumgarte's form of (9); whether steps end with projections (10), below zero as
   the formulation has it. No variable of a scene: a binding sets them. */
Outcome instance_stabilise(Instance *i, double zeta, double omega, int projection)
{
    if (i->flags.phase & RUN)
        return say(i, REFUSED, "%s: zeta, omega and the projection are fixed once the run has begun; set them before "
                               "initialising",
            i->scene->name);
    if (!isfinite(zeta) || !isfinite(omega))
        return say(i, REFUSED, "%s: zeta = %g, omega = %g; they must be finite numbers", i->scene->name, zeta, omega);
    i->stabilisation[0] = zeta;
    i->stabilisation[1] = omega;
    *i->projection = projection;
    i->flags.initialized = 0;
    return DONE;
}

/* An input's time derivative in the next communication step. */
Outcome instance_set_slope(Instance *i, int reference, double value)
{
    const Scene *s = i->scene;
    if (!isfinite(value))
        return say(i, REFUSED, "%s: the derivative of %s is %g; it must be a finite number", s->name,
            s->variables[reference].name, value);
    start_again(i, value != i->slopes[1 + reference - s->parameters - s->choices]);
    i->slopes[1 + reference - s->parameters - s->choices] = value;
    return DONE;
}

/* A value for a message: some C libraries write the sign of what is no number, which means nothing. */
static double unsigned_nan(double value)
{
    return isnan(value) ? fabs(value) : value;
}

/* Where the value of a variable stands; NULL for a choice. */
static inline const double *place_of_value(const Instance *i, int reference)
{
    const Scene *s = i->scene;
    const int output = reference - outputs_from(s), event = output - (s->outputs - s->event_count);
    if (output >= s->outputs)
        return i->jacobian + (output - s->outputs);
    if (event >= 0)
        return s->event_places[event] < s->impulses ? i->impulses + s->event_places[event]
            : s->event_places[event] == s->impulses ? i->lost
                                                    : i->peaks + (s->event_places[event] - s->impulses - 1);
    if (output >= 0)
        return i->m + s->seen + output;
    if (reference < s->parameters)
        return i->values + reference;
    reference -= s->parameters;
    if (reference < s->choices)
        return NULL;
    reference -= s->choices;
    return reference < s->inputs ? i->m + s->u + reference : i->wanted + (reference - s->inputs);
}

static inline double value_of(const Instance *i, int reference)
{
    const double *place = place_of_value(i, reference);
    return place ? *place : i->flags.choice[reference - i->scene->parameters] + 1;
}

const double *instance_place(const Instance *i, int reference)
{
    return place_of_value(i, reference);
}

double instance_get(const Instance *i, int reference)
{
    return value_of(i, reference);
}

void instance_get_many(const Instance *i, const int *references, int count, double *values)
{
    for (int k = 0; k < count; k++)
        values[k] = value_of(i, references[k]);
}

/* Equations -------------------------------------------------------------------------------------------------------- */

/* A matrix of nonzeros within the first of `rows` rows of a dense one. */
void spread(const Pattern *pattern, const double *values, double *dense, int rows)
{
    for (int c = 0; c < pattern->columns; c++) {
        memset(dense + c * rows, 0, (size_t)pattern->rows * sizeof *dense);
        for (int k = pattern->offsets[c]; k < pattern->offsets[c + 1]; k++)
            dense[c * rows + pattern->indices[k]] = values[k];
    }
}

/* M, C (their nonzeros), Phi and C v; each may be NULL. */
void constraints_at(
    Instance *i, const double *q, const double *v, double *mass, double *matrix, double *phi, double *cv)
{
    const Scene *s = i->scene;
    const size_t used = i->used, l = (size_t)s->l;
    const double *x[] = {q, v, field(i, s->p)};
    double *y[] = {mass ? mass : take(i, (size_t)s->mass.entries),
        matrix ? matrix : take(i, (size_t)s->constraint.entries), phi ? phi : take(i, l), cv ? cv : take(i, l)};
    call(i, s->constraints, x, y);
    i->used = used;
}

/* The largest |Phi|, or |Phi-dot|, in units of its row, and which row it is. */
double widest(Instance *i, const double *q, const double *v, int of_velocity, int *row)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *phi = take(i, (size_t)s->l), *cv = take(i, (size_t)s->l), found = 0.0;
    constraints_at(i, q, v, NULL, NULL, phi, cv);
    *row = 0;
    for (int r = 0; r < s->l; r++) {
        const double size = fabs((of_velocity ? cv : phi)[r] / i->units[r]);
        if (i->penalty[r] > 0.0 && !(size <= found)) {
            found = isnan(size) ? INFINITY : size;
            *row = r;
        }
    }
    i->used = used;
    return found;
}

const char *row_label(const Instance *i, int row, char *label, size_t size)
{
    const Row *r = i->scene->rows + row;
    snprintf(label, size, *r->direction ? "%s %s" : "%s", r->name, r->direction);
    return label;
}

/* Formulations ----------------------------------------------------------------------------------------------------- */

/* Reads by loops that stop on convergence, where accelerations are read at all. */
static int instant_by(const Scene *s, int formulation)
{
#define OF(name) , s->instant_##name
    const int programs[] = {s->instant_patient SCENE_OTHERS(OF)};
#undef OF
    return programs[formulation] < 0 ? s->instant : programs[formulation];
}

static int formulation(const Instance *i)
{
    return i->flags.choice[i->scene->formulation];
}

/* Whether steps end with projections (10). */
static int projects(const Instance *i)
{
    static const int usual[] = {PROJECTED};
    return *i->projection < 0.0 ? usual[formulation(i)] : *i->projection > 0.0;
}

/* Whether all programs of the scene are those of what is chosen, not `move` and `instant` alone. */
static int all_serve(const Instance *i)
{
    return !i->scene->l || (formulation(i) == RESIDUAL_FORMULATION && projects(i));
}

/* Whether the penalty is not the one that is scaled with the masses. */
static int penalty_given(const Instance *i)
{
    return i->values[i->scene->penalty] > 0.0 || i->flags.given;
}

/* What else may help where something fails. */
static const char *or_penalty(const Instance *i)
{
    return penalty_given(i) ? "; or solver.penalty 0, which scales it with the masses" : "";
}

/* What to do, too, where loads are shared by compliances that are too far apart for the passes there are. */
static const char *or_compliances(const Instance *i, char *text, size_t size)
{
    double least = INFINITY;
    *text = '\0';
    for (int r = 0; r < i->scene->compliances; r++)
        least = fmin(least, i->compliances[r]);
    if (least > 0.0 && least < INFINITY)
        write_text(text, size, "; or compliances of constraints that are closer together (they differ by a factor of %.1g)",
            largest(i->compliances, i->scene->compliances) / least);
    return text;
}

/* Whether a step has been made, so that its length may be at fault. */
static int moving(const Instance *i)
{
    const double *tally = i->m + i->scene->tally;
    double made = i->counts[PATIENT_STEPS] + tally[TALLY_COVERED];
    for (int tier = TALLY_QUICK; tier <= TALLY_BRANCH; tier++)
        made += tally[tier];
    return made > 0.0;
}

/* What to do where something is wrong that shorter steps may mend. */
static const char *shorter(const Instance *i)
{
    return moving(i) ? "reduce solver.step_size" : "check forces, dimensions and start values";
}

/* What to do where a loop ends before it converges. */
static const char *remedy(const Instance *i)
{
    return penalty_given(i) ? "use solver.penalty 0, which scales it with the masses" : shorter(i);
}

/* FAILED where an evaluation, by what it says of itself, left so much of a given penalty's multiplier iteration that it
   is no acceleration of this motion; less is counted. */
static Outcome check_converged(Instance *i, const double *watch, double t)
{
    const Scene *s = i->scene;
    const double tolerance = i->values[s->tolerance], alpha = i->values[s->penalty];
    const double left = sqrt(watch[WATCH_CHANGE] / (watch[WATCH_SIZE] + DBL_MIN));
    if (watch[WATCH_CHANGE] <= tolerance * tolerance * watch[WATCH_SIZE] + DBL_MIN)
        return DONE;
    i->counts[UNCONVERGED] += 1.0;
    if (!(left > UNFINISHED) || !penalty_given(i) || field(i, s->k)[SETTINGS_CONTINUES] == 0.0) {
        warn(i, WARNED_OF_UNCONVERGED,
            "%s, t = %.6g s: an evaluation ended without convergence after %g passes of the multiplier iteration; %s, or "
            "raise solver.max_iterations",
            s->name, t, i->values[s->max_iterations], remedy(i));
        return DONE;
    }
    return say(i, FAILED,
        "%s, t = %.6g s: with solver.penalty %g the multiplier iteration still changes accelerations by %.1e of themselves "
        "after %g passes, more than %.0e; %s, or raise solver.max_iterations",
        s->name, t, alpha > 0.0 ? alpha : largest(i->penalty, s->l), left, i->values[s->max_iterations], UNFINISHED,
        remedy(i));
}

/* Quantities of first-order equations now. */
static double *states(const Instance *i)
{
    return field(i, i->scene->z) + i->scene->work + 1;
}

/* DONE where accelerations can be computed at q, v; `pivot` is the smallest of what was factorised there. */
static Outcome explained(Instance *i, const double *q, const double *v, double t, double pivot)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *M = take(i, (size_t)s->mass.entries), *C = take(i, (size_t)s->constraint.entries);
    double *F = take(i, (size_t)s->n), *xi = take(i, (size_t)s->l), *u = take(i, (size_t)driven_by(s));
    const double *x[] = {q, v, u, field(i, s->p), &t};
    double *y[] = {M, C, F, xi};
    Outcome outcome = DONE;
    memcpy(u, field(i, s->u), (size_t)s->inputs * sizeof *u);
    memcpy(u + s->inputs, states(i), (size_t)states_of(s) * sizeof *u);
    call(i, s->dynamics, x, y);
    if (!isfinite(largest(M, s->mass.entries)) || !isfinite(largest(F, s->n)) || !isfinite(largest(xi, s->l)))
        outcome = say(i, FAILED, "%s, t = %.6g s: the equations of motion are not finite; %s", s->name, t, shorter(i));
    else if (!(pivot > 0.0))
        outcome = say(i, FAILED,
            "%s, t = %.6g s: the augmented mass matrix is singular; give the massless body a mass, or hold it by "
            "constraints%s",
            s->name, t, or_penalty(i));
    i->used = used;
    return outcome;
}

/* What programs need beside the memory. */
void hand_over(Instance *i)
{
    const Scene *s = i->scene;
    const double iterations = i->values[s->max_iterations];
    i->workspace[s->most] = fmax(iterations - 1, 1.0);
    i->workspace[s->patient] = PATIENT * iterations - 1;
    i->workspace[s->again] = iterations - 1;
    memcpy(i->workspace + s->stabilisation, i->stabilisation, 2 * sizeof(double));
    i->workspace[s->projects] = projects(i);
    memcpy(i->workspace + s->slopes, i->slopes, (size_t)(s->inputs + 1) * sizeof(double));
    if (s->reach >= 0)
        i->workspace[s->within] = i->within;
}

/* Penalties, units and shares of constraints handed on to the kernel; redundant constraints as they are. */
void weigh(Instance *i)
{
    const Scene *s = i->scene;
    double *k = field(i, s->k), *rows = k + SETTINGS, most = largest(i->penalty, s->l), least = INFINITY;
    double *shares = rows + 2 * s->l + s->n, *matrix = shares + s->compliances;
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

/* Whether a motion goes on along its branch near a singular position. */
static int continues(const Instance *i)
{
    return all_serve(i) && i->flags.choice[i->scene->branch] == i->scene->continues;
}

/* What makes the steps: 0 RK4, 1 the method of the scene with error control, 2 the same in steps of one length. What `auto`
   stands for takes one formulation alone, and passes singular positions along the branch. */
int method(const Instance *i)
{
    const Scene *s = i->scene;
    const int rk4 = i->flags.choice[s->method_choice] == s->rk4_choice || (s->automatic && s->l && !continues(i));
    return rk4 ? 0 : s->method;
}

/* The tolerance of a step for that of a run; in proportion for explicit methods, and less where it is loose. */
static double of_step(double share, double exponent, double run)
{
    return share * pow(run, exponent) * (exponent == 1.0 ? pow(fmin(1.0, STEADY / run), LOOSER) : 1.0);
}

/* The kernel told what the settings ask for. */
void settle_kernel(Instance *i)
{
    const Scene *s = i->scene;
    double *k = field(i, s->k), *rows = k + SETTINGS, *control = field(i, s->control);
    const double relative = i->values[s->relative_tolerance], absolute = i->values[s->absolute_tolerance];
    const double pivot_of_mass = *i->freedom > 0.0 ? exp(*i->masses / *i->freedom) : 0.0;
    weigh(i);
    k[SETTINGS_FREEDOM] = *i->freedom;
    k[SETTINGS_MASSES] = *i->masses;
    k[SETTINGS_REGULAR] = exp(*i->regular);
    k[SETTINGS_NOTHING] = NOISE_FLOOR * pivot_of_mass;
    k[SETTINGS_LEAST_DISTANCE] = fmax(LEAST_DISTANCE, CONVERGENCE * sqrt(pivot_of_mass));
    k[SETTINGS_CONTINUES] = s->l && continues(i);
    k[SETTINGS_RELATIVE] = s->method ? of_step(s->share, s->exponent, relative) : 0.0;
    k[SETTINGS_ABSOLUTE] = s->method ? of_step(s->share, s->exponent, absolute > 0.0 ? absolute : relative) : 0.0;
    k[SETTINGS_ABSOLUTE_LENGTH] = k[SETTINGS_ABSOLUTE] * *i->length;
    k[SETTINGS_INVERSE_LENGTH] = 1 / *i->length;
    k[SETTINGS_BESIDE] =
        s->method == 1 ? of_step(s->beside_share, s->beside_exponent, relative) / k[SETTINGS_RELATIVE] : 1.0;
    k[SETTINGS_SHORT] = s->method == 1 ? s->short_share * pow(relative, s->short_exponent) / k[SETTINGS_RELATIVE] : 0.0;
    k[SETTINGS_STIFF] =
        s->method == 1 ? of_step(s->stiff_share, s->stiff_exponent, relative) / k[SETTINGS_RELATIVE] : 1.0;
    for (int c = 0; c < s->n; c++)
        rows[2 * s->l + c] = *i->largest_penalty / (s->l ? i->scales[c] : 1.0);
    field(i, s->dt)[0] = control[CONTROL_STEP_SIZE] = i->values[s->step_size];
    control[CONTROL_TIER] = !(i->flags.scaled || s->same_tiers);
    control[CONTROL_METHOD] = method(i);
    i->flags.fast = !s->l || (all_serve(i) && i->values[s->max_iterations] >= s->careful_iterations);
    i->flags.whole = i->flags.fast && !i->flags.brakes;
    if (i->flags.brakes)
        hold(i);
}

/* Angles whose turns count as they are now: where they were last, for what comes. Nothing changes with them but turns. */
void count_turns(Instance *i)
{
    const Scene *s = i->scene;
    const int behind = s->counted + (s->timed ? 1 + s->followed_count * POLYNOMIAL : 0);
    if (s->counted)
        memcpy(field(i, s->p) + s->own + s->held - behind, field(i, s->z) + s->work - s->counted,
            (size_t)s->counted * sizeof(double));
}

void parameters(Instance *i)
{
    const Scene *s = i->scene;
    double *p = field(i, s->p);
    memcpy(p, i->values, (size_t)s->own * sizeof *p);
    memcpy(p + s->own, i->kept, (size_t)s->held * sizeof *p);
    tape_copy(i, p, i->values, (size_t)s->own);
    tape_copy(i, p + s->own, i->kept, (size_t)s->held);
    count_turns(i);
}

/* Topology --------------------------------------------------------------------------------------------------------- */

void in_force(const Instance *i, const double *on, unsigned char *held)
{
    const Scene *s = i->scene;
    memset(held, 1, (size_t)s->l);
    for (int k = 0; k < s->switches; k++)
        for (int r = 0; r < s->switched[k].count; r++)
            held[s->switched[k].rows[r]] = (on[k] != 0.0) == s->switched[k].holds;
    for (int k = 0; k < s->frictions; k++)
        held[s->friction[k].row] = i->kept[s->friction[k].slip] == 0.0;
}

/* Whether the constraints in force are the usual ones. */
static int usual(Instance *i)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    unsigned char *held = (unsigned char *)take(i, (size_t)s->l);
    double *off = take(i, (size_t)s->switches);
    int same = 1;
    memset(off, 0, (size_t)s->switches * sizeof *off);
    in_force(i, off, held);
    for (int k = 0; k < s->frictions; k++)
        held[s->friction[k].row] = 0;
    for (int r = 0; r < s->l; r++)
        same &= (i->penalty[r] > 0.0) == held[r];
    i->used = used;
    return same;
}

Outcome knowledge(Instance *i, const double *q, const double *v)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    unsigned char *held = (unsigned char *)take(i, (size_t)s->l);
    Outcome outcome = DONE;
    for (int r = 0; r < s->l; r++)
        held[r] = i->penalty[r] > 0.0;
    *i->freedom = s->n;
    *i->masses = 0.0;
    if (s->l)
        know(i, q, v, held, usual(i));
    if (i->flags.brakes && !s->brakes)
        outcome = say(i, BRAKES,
            "%s: redundant constraints would brake the motion with these parameters; export it with them (--set)",
            s->name);
    i->used = used;
    return outcome;
}

/* Kinetic and potential energy with these velocities, and the kinetic one alone. */
static double energy(Instance *i, const double *v, double *kinetic)
{
    const Scene *s = i->scene;
    double found;
    const double *x[] = {field(i, s->z), v, field(i, s->p)};
    double *y[] = {&found, kinetic};
    call(i, s->energy, x, y);
    return found;
}

/* The energy now into a place of its own, written down where there is a tape. */
static void energy_into(Instance *i, const double *v, double *into)
{
    const Scene *s = i->scene;
    const double *x[] = {field(i, s->z), v, field(i, s->p)};
    double *y[] = {into, into + 1};
    taped_call(i, s->energy, x, y);
}

/* What a motion does in an instant is what energies change by, from those at the first of four places. */
static void worked_at_once(Instance *i, double *energies)
{
    double *q = field(i, i->scene->z), *work = q + i->scene->work;
    const double *from[] = {work, energies + 2, energies}, factors[] = {1.0, 1.0, -1.0};
    energy_into(i, q + i->scene->n, energies + 2);
    *work += energies[2] - energies[0];
    tape_sum(i, work, 3, from, factors);
}

static const char *method_name(const Instance *i)
{
    const Scene *s = i->scene;
    return s->choice[s->method_choice].values[i->flags.choice[s->method_choice]];
}

static double margin(Instance *i)
{
    const Scene *s = i->scene;
    const size_t used = i->used, n = (size_t)s->n;
    double found;
    const double *x[] = {field(i, s->z), field(i, s->p), field(i, s->k)};
    double *y[] = {take(i, n), take(i, n), take(i, n), &found};
    call(i, s->pivots, x, y);
    i->used = used;
    return found;
}

/* Warns that dry friction took no part in an impact, where it took as much kinetic energy [J] as a balance tells. */
static void tell_of_impact(Instance *i, const double *v, double lost)
{
    const Scene *s = i->scene;
    double kinetic;
    energy(i, v, &kinetic);
    if (lost > UNBALANCED * (kinetic + lost))
        warn(i, WARNED_OF_IMPACT,
            "%s, t = %.6g s: an impact took %.3g J, and dry friction took no part in it: impulses of joints that rub, such "
            "as %s, have no friction",
            s->name, *instance_time(i), lost, s->rows[s->friction[0].row].name);
}

/* Other constraints from now on; what comes into force must be closed, and makes the velocity consistent. */
static Outcome change(Instance *i, const double *on)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *q = field(i, s->z), *v = q + s->n, *w = i->workspace, *work = q + s->work, gap;
    double *energies = take(i, 4);
    unsigned char *held = (unsigned char *)take(i, (size_t)s->l), *new = (unsigned char *)take(i, (size_t)s->l);
    char label[100];
    int row, any = 0;
    Outcome outcome;
    in_force(i, on, held);
    for (int r = 0; r < s->l; r++) {
        const int before = i->penalty[r] > 0.0;
        i->penalty[r] = held[r] ? i->full[r] : 0.0;
        held[r] = i->penalty[r] > 0.0;
        new[r] = held[r] && !before;
        any |= new[r];
    }
    weigh(i);
    gap = widest(i, q, v, 0, &row);
    if (!(gap <= GROSS))
        outcome = say(i, REFUSED,
            "%s, t = %.6g s: a constraint that is open by %.3g at %s cannot be switched on; wait until it closes",
            s->name, *instance_time(i), gap, row_label(i, row, label, sizeof label));
    else
        outcome = check_masses(i, q, held);
    if (outcome == DONE && any) {
        const double *lost[] = {work, w + s->lost}, factors[] = {1.0, 1.0}, once_less[] = {1.0, -1.0};
        if (s->timed)
            energy_into(i, v, energies);
        run(i, s->impact);
        memcpy(v, w + s->struck, (size_t)s->n * sizeof *v);
        tape_copy(i, v, w + s->struck, (size_t)s->n);
        if (s->timed) /* What comes into force while it moves does work, too. */
            worked_at_once(i, energies);
        else {
            *work += -w[s->lost];
            tape_sum(i, work, 2, lost, once_less);
        }
        *i->lost += w[s->lost];
        lost[0] = i->lost;
        tape_sum(i, i->lost, 2, lost, factors);
        for (int k = 0; k < s->impulses; k++)
            if (new[s->impulse_rows[k]]) {
                i->impulses[k] = w[s->impulse + s->impulse_rows[k]];
                tape_copy(i, i->impulses + k, w + s->impulse + s->impulse_rows[k], 1);
            }
        if (s->frictions)
            tell_of_impact(i, v, w[s->lost]);
        gap = widest(i, q, v, 1, &row);
        if (!(gap <= CONTRADICTION))
            outcome = say(i, REFUSED,
                "%s, t = %.6g s: what is switched on asks for another motion than what is in force: no velocities serve both, "
                "as %s is missed by %.3g per second; switch one of them off",
                s->name, *instance_time(i), row_label(i, row, label, sizeof label), gap);
    }
    if (outcome == DONE)
        outcome = knowledge(i, q, v);
    if (outcome == DONE)
        settle_kernel(i);
    i->flags.known = 0;
    i->used = used;
    return outcome;
}

void instance_remember(Instance *i)
{
    memcpy(i->before, i->numbers, i->count * sizeof *i->numbers);
    i->flags_before = i->flags;
}

void instance_go_back(Instance *i)
{
    memcpy(i->numbers, i->before, i->count * sizeof *i->numbers);
    i->flags = i->flags_before;
    i->onward = 0; /* Something else may have been read. */
}

/* What the Boolean inputs ask for put in force at this instant. */
static Outcome take_effect(Instance *i)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    Outcome outcome;
    peaks_broken(i);
    if (s->held) {
        double *displacements = take(i, (size_t)s->held);
        const double *x[] = {field(i, s->z), field(i, s->p)};
        double *y[] = {displacements};
        taped_call(i, s->displacements, x, y);
        for (int k = 0; k < s->switches; k++)
            if (s->switched[k].value >= 0 && i->wanted[k] != 0.0 && i->on[k] == 0.0) {
                i->kept[s->switched[k].value] = displacements[s->switched[k].value];
                tape_copy(i, i->kept + s->switched[k].value, displacements + s->switched[k].value, 1);
            }
        parameters(i);
    }
    if (s->frictions) {
        friction_reset(i); /* An impact takes no friction; what sticks is told again after it. */
        parameters(i);
    }
    outcome = change(i, i->wanted);
    if (outcome == DONE)
        outcome = friction_begin(i);
    if (outcome == DONE)
        memcpy(i->on, i->wanted, (size_t)s->switches * sizeof *i->on);
    i->flags.pending = 0;
    i->used = used;
    return outcome;
}

/* Start ------------------------------------------------------------------------------------------------------------ */

/* Whether |Phi|, or |Phi-dot|, of every row is within the tolerance, or within the round-off of the row. */
static int closed(Instance *i, const double *residue, const double *C, const double *x)
{
    const Scene *s = i->scene;
    const Pattern *p = &s->constraint;
    const size_t used = i->used;
    double *sizes = take(i, (size_t)s->l);
    int all = 1;
    memset(sizes, 0, (size_t)s->l * sizeof *sizes);
    for (int c = 0; c < s->n; c++)
        for (int e = p->offsets[c]; e < p->offsets[c + 1]; e++)
            sizes[p->indices[e]] += fabs(C[e] * x[c]);
    for (int r = 0; r < s->l; r++)
        all &= !(i->penalty[r] > 0.0)
            || fabs(residue[r]) <= fmax(i->values[s->tolerance] * i->units[r], ROUND_OFF * sizes[r]);
    i->used = used;
    return all;
}

/* q and v brought back to the constraints. */
Outcome projected(Instance *i, double *q, double *v)
{
    const Scene *s = i->scene;
    const size_t used = i->used, l = (size_t)s->l, n = (size_t)s->n;
    double *C = take(i, (size_t)s->constraint.entries), *phi = take(i, l), *cv = take(i, l), *next = take(i, n);
    double pivot, left[2];
    const double *x[] = {q, field(i, s->p), field(i, s->k)}, *at[] = {q, v, field(i, s->p), field(i, s->k)};
    double *y[] = {next}, *settled[] = {next, &pivot, left};
    char label[100];
    Outcome outcome = DONE;
    for (int pass = 0; pass < CORRECTIONS; pass++) {
        constraints_at(i, q, v, NULL, C, phi, cv);
        if (closed(i, phi, C, q))
            break;
        taped_call(i, s->place, x, y);
        memcpy(q, next, n * sizeof *q);
        tape_copy(i, q, next, n);
    }
    for (int pass = 0; pass < CORRECTIONS; pass++) {
        constraints_at(i, q, v, NULL, C, phi, cv);
        if (closed(i, cv, C, v))
            break;
        taped_call(i, s->settle, at, settled);
        memcpy(v, next, n * sizeof *v);
        tape_copy(i, v, next, n);
    }
    for (int of_velocity = 0; of_velocity < 2 && outcome == DONE; of_velocity++) {
        int row;
        const double worst = widest(i, q, v, of_velocity, &row);
        if (!(worst <= GROSS))
            outcome = say(i, OPEN,
                "%s, t = %.6g s: %s = %.1e at %s > %.0e after %d corrections; %s", s->name, *instance_time(i),
                of_velocity ? "|Phi-dot|" : "|Phi|", worst, row_label(i, row, label, sizeof label), GROSS,
                CORRECTIONS, remedy(i));
    }
    i->used = used;
    return outcome;
}

/* The kinetic one where all velocities are of one size. */
static double kinetic_energy_at(Instance *i, double speed)
{
    const size_t used = i->used, n = (size_t)i->scene->n;
    double *v = take(i, n), kinetic;
    for (size_t k = 0; k < n; k++)
        v[k] = speed;
    energy(i, v, &kinetic);
    i->used = used;
    return kinetic;
}

/* Whether the last communication step begins and ends at rest in one place. The work of a large force is then that of the
   last digits of the velocities, and its energy none. */
static int rested(Instance *i, double kinetic)
{
    const Scene *s = i->scene;
    const double *now = field(i, s->z), *begin = field(i, s->begin);
    for (int c = 0; c < dependent(s); c++)
        if (!(fabs(now[c] - begin[c]) <= RESTING && fabs(now[s->n + c]) <= SLOW_MOTION
                && fabs(begin[s->n + c]) <= SLOW_MOTION))
            return 0;
    /* Places may move although no coordinate does. */
    return !s->timed || kinetic <= kinetic_energy_at(i, SLOW_MOTION);
}

/* Where no work is done, a balance that is off by a part of the energy puts rates off by half of that, so that the place
   comes off by as much of the way. */
static void drifts(Instance *i)
{
    const Scene *s = i->scene;
    const double *now = field(i, s->z), *begin = field(i, s->begin), h = now[s->time] - begin[s->time];
    double *c = i->counts, rate = 0.0;
    if (now[s->work] != 0.0)
        return;
    for (int k = 0; k < dependent(s); k++)
        rate = fmax(rate, (fabs(now[s->n + k]) + fabs(begin[s->n + k])) / 2);
    c[DRIFT] += c[BALANCE] / c[ENERGY_SCALE] / 2 * rate * h;
    if (fabs(c[DRIFT]) > UNBALANCED)
        warn(i, WARNED_OF_DRIFT,
            "%s, t = %.6g s: by the drift of its energy the motion has come off by some %.1g rad (or m), and it comes off more and "
            "more; %s, and judge the run by one with --check",
            s->name, now[s->time], fabs(c[DRIFT]), method(i) == 1 ? "take a smaller solver.relative_tolerance" : "take shorter steps");
}

/* The balance of energies after a communication step, where anybody reads of it. */
void instance_balance(Instance *i)
{
    const Scene *s = i->scene;
    const double *z = field(i, s->z), work = z[s->work];
    double *c = i->counts, found, kinetic, off;
    if (!s->balances)
        return;
    found = energy(i, z + s->n, &kinetic);
    off = found - c[ENERGY_START] - work - c[AT_REST];
    if (rested(i, kinetic)) {
        c[AT_REST] += off - c[BALANCE];
        off = c[BALANCE];
    }
    c[ENERGY_SCALE] = fmax(c[ENERGY_SCALE], fmax(kinetic, fabs(work)));
    c[STEP_ERROR] = fabs(off - c[BALANCE]) / c[ENERGY_SCALE];
    c[BALANCE] = off;
    c[RUN_ERROR] = fmax(c[RUN_ERROR], fabs(off) / c[ENERGY_SCALE]);
    drifts(i);
    if (!(c[RUN_ERROR] <= UNBALANCED))
        warn(i, WARNED_OF_BALANCE,
            "%s, t = %.6g s: the balance of energies is off by %.2g of the energy of the motion; %s", s->name,
            z[s->time], c[RUN_ERROR],
            method(i) == 1 ? "use a smaller solver.relative_tolerance"
            : s->l && !continues(i)
                ? "near singular positions solver.formulation residual with solver.branch continue keeps it; elsewhere take "
                  "a smaller solver.step_size"
                : "steps of solver.step_size are too long: take shorter ones, or solver.method explicit or stiff, which "
                  "control their error");
}

/* What the last communication step changed of the balance, where somebody reads it. */
static void tell_step_error(Instance *i)
{
    const Scene *s = i->scene;
    double *told = i->m + s->seen + s->monitor_step_error;
    if (s->monitor_step_error >= 0) {
        *told = i->counts[STEP_ERROR];
        tape_clearing(i, told, 1);
    }
}

static Outcome comply(Instance *i)
{
    const Scene *s = i->scene;
    const int first = s->own + 2 * s->starts;
    int given = 0;
    for (int k = 0; k < s->compliances; k++) {
        i->compliances[k] = i->values[first + k];
        given += i->compliances[k] > 0.0;
    }
    if (!given || given == s->compliances)
        return DONE;
    for (int k = 0;; k++)
        if (i->compliances[k] == 0.0)
            return say(i, REFUSED, "%s: %s is 0 and others are not; give each constraint a compliance, or none",
                s->name, s->variables[first + k].name);
}

/* DONE where constraints agree as well as steps under error control ask for. */
static Outcome agreed(Instance *i, const unsigned char *held, const double *q, const double *v)
{
    const Scene *s = i->scene;
    const size_t used = i->used, l = (size_t)s->l;
    double *C = take(i, (size_t)s->constraint.entries), *phi = take(i, l), *cv = take(i, l);
    Outcome outcome = DONE;
    constraints_at(i, q, v, NULL, C, phi, cv);
    if (!closed(i, phi, C, q))
        outcome = check_agreement(i, held, q, phi, "");
    if (outcome == DONE && !closed(i, cv, C, v))
        outcome = check_agreement(i, held, q, cv, "/s");
    i->used = used;
    return outcome;
}

/* Computed angles begin near their start values. */
static void angles_begin(Instance *i)
{
    const Scene *s = i->scene;
    double *z = field(i, s->z);
    for (int k = 0; k < s->angles; k++) {
        const double *angle = s->angle_starts[k] < 0 ? NULL : i->values + s->own + s->angle_starts[k];
        z[2 * s->n + k] = angle ? *angle : 0.0;
        if (angle)
            tape_copy(i, z + 2 * s->n + k, angle, 1);
    }
}

/* The motion begins at q and v; nothing has been counted. */
static void begin_at(Instance *i, const double *q, const double *v, double time)
{
    const Scene *s = i->scene;
    double *z = field(i, s->z), kinetic;
    const double *first = i->values + s->own + 2 * s->starts + s->compliances;
    memset(z, 0, state_length(s) * sizeof *z);
    memcpy(z, q, (size_t)s->n * sizeof *q);
    memcpy(z + s->n, v, (size_t)s->n * sizeof *v);
    tape_clearing(i, z, state_length(s));
    tape_copy(i, z, q, (size_t)s->n);
    tape_copy(i, z + s->n, v, (size_t)s->n);
    angles_begin(i);
    memcpy(states(i), first, (size_t)states_of(s) * sizeof *z);
    tape_copy(i, states(i), first, (size_t)states_of(s));
    z[s->time] = time;
    memset(i->impulses, 0, (size_t)s->impulses * sizeof *i->impulses);
    memset(i->jacobian, 0, (size_t)s->entries * sizeof *i->jacobian);
    memset(i->peaks, 0, peaks_length(s) * sizeof *i->peaks);
    *i->lost = 0.0;
    memset(field(i, s->pace), 0, PACE * sizeof(double));
    field(i, s->pace)[0] = FIRST_STEP;
    field(i, s->pace)[1] = LEAST_BEFORE;
    memset(i->counts, 0, COUNTED * sizeof *i->counts);
    memset(field(i, s->tally), 0, TALLY * sizeof(double));
    i->counts[ENERGY_START] = energy(i, z + s->n, &kinetic);
    /* A motion slower than this is none. */
    i->counts[ENERGY_SCALE] = fabs(kinetic_energy_at(i, SLOW_MOTION)) + DBL_MIN;
    i->flags.warned = i->warns = 0;
    i->shared = 0;
}

static Outcome started(Instance *i)
{
    const Scene *s = i->scene;
    const size_t l = (size_t)s->l, n = (size_t)s->n;
    double *q = take(i, n), *v = take(i, n), alpha = i->values[s->penalty], heavy = 0.0;
    int light = -1; /* a constraint whose penalty is below the mass that it holds */
    unsigned char *held = (unsigned char *)take(i, l);
    const double time = *instance_time(i);
    Outcome outcome;
    signals_begin(i, time);
    friction_reset(i);
    angles_begin(i);
    parameters(i);
    for (int k = 0; k < s->switches; k++)
        i->on[k] = i->wanted[k] != 0.0 && !s->switched[k].holds;
    in_force(i, i->on, held);
    for (int r = 0; r < s->l; r++)
        held[r] &= !(i->flags.given && i->given[r] == 0.0);
    outcome = assemble(i, held, q, v);
    if (outcome == DONE)
        outcome = check_masses(i, q, held);
    if (outcome == DONE)
        outcome = comply(i);
    if (outcome != DONE)
        return outcome;
    default_penalties(i, q, i->full);
    /* Whether the penalty is the one for which the quick step of the kernel is known to be enough. */
    i->flags.scaled = alpha == 0.0 && !i->flags.given;
    for (int r = 0; r < s->l; r++) {
        const double mass = i->full[r] / PENALTY_RATIO;
        i->flags.scaled &= s->weighted || i->full[r] == i->full[0];
        i->full[r] = i->flags.given ? i->given[r] : alpha > 0.0 ? alpha : i->full[r];
        if (held[r] && i->full[r] < mass * (1 - 1e-9) && mass > heavy)
            heavy = mass, light = r;
    }
    for (int r = 0; r < s->l; r++)
        i->penalty[r] = held[r] ? i->full[r] : 0.0;
    weigh(i);
    if (s->l && projects(i))
        outcome = projected(i, q, v);
    if (outcome == DONE)
        outcome = knowledge(i, q, v);
    if (outcome == DONE && s->l && method(i) == 1)
        outcome = agreed(i, held, q, v);
    if (outcome != DONE)
        return outcome;
    begin_at(i, q, v, time);
    if (s->l)
        warn_of_second_order(i, held, q);
    if (light >= 0)
        warn(i, WARNED_OF_PENALTY,
            "%s: solver.penalty %g is below the mass %g that %s %s holds, so that multipliers may be wrong; use 0, which "
            "scales it with the masses",
            s->name, i->full[light], heavy, s->rows[light].name, s->rows[light].direction);
    settle_kernel(i);
    /* At rest near a singular position nothing else tells the direction along which a limit is taken. */
    if (s->l && continues(i) && largest(v, dependent(s)) == 0.0 && margin(i) < BRANCH_MARGIN)
        set_off(i, held, q, field(i, s->z) + s->n);
    for (int k = 0; k < s->switches; k++)
        if (i->wanted[k] != i->on[k])
            return take_effect(i);
    return friction_begin(i);
}

/* The tolerance of a run that the host wants, where the method controls its error. */
Outcome instance_tolerate(Instance *i, double tolerance)
{
    return i->scene->method == 1 ? instance_set(i, i->scene->relative_tolerance, tolerance) : DONE;
}

Outcome instance_initialize(Instance *i)
{
    const Scene *s = i->scene;
    Outcome outcome;
    if (s->entries && differentiable(i) != DONE)
        return REFUSED;
    if (method(i) && !all_serve(i))
        return say(i, REFUSED,
            "%s: solver.method %s takes solver.formulation residual with projections here; choose that, or export with "
            "solver.method rk4",
            s->name, method_name(i));
    if (s->frictions && !all_serve(i))
        return say(i, REFUSED,
            "%s: dry friction is solved for in the multiplier iteration of solver.formulation residual with projections; "
            "choose that",
            s->name);
    i->used = 0;
    i->flags.initialized = i->flags.known = i->flags.pending = 0;
    hand_over(i);
    outcome = started(i);
    i->used = 0;
    outcome = laws_begun(i, outcome);
    i->flags.initialized = outcome == DONE;
    return outcome;
}

/* Steps ------------------------------------------------------------------------------------------------------------ */

/* FAILED where a move from `start` ends at no finite state, in the words of its first stage that went wrong. */
static Outcome check_finite(Instance *i, double start, double dt)
{
    const Scene *s = i->scene;
    const double *w = i->workspace;
    const struct {
        int watch, q, v;
        double t;
    } stages[] = {{s->watch1, s->q1, s->v1, start}, {s->watch2, s->q2, s->v2, start + dt / 2},
        {s->watch3, s->q3, s->v3, start + dt / 2}, {s->watch4, s->q4, s->v4, start + dt}};
    if (isfinite(norm(w + s->q, s->n)) && isfinite(norm(w + s->v, s->n)))
        return DONE;
    for (int k = 0; k < 4; k++) {
        const double pivot = w[stages[k].watch + WATCH_PIVOT];
        const Outcome outcome = explained(i, w + stages[k].q, w + stages[k].v, stages[k].t, pivot);
        if (outcome != DONE)
            return outcome;
    }
    return say(i, FAILED, "%s, t = %.6g s: the state is not finite; reduce solver.step_size", s->name, start + dt);
}

/* FAILED where a move that ends at the positions in the workspace is too long to mean anything, or opens a constraint
   that projections should close. */
static Outcome check_length(Instance *i, double t)
{
    const Scene *s = i->scene;
    const double *q = i->workspace + s->q, *v = i->workspace + s->v, *from = field(i, s->z);
    double turned = 0.0, moved = 0.0, gap;
    char label[100];
    int worst = 0, row;
    for (int c = 0; c < dependent(s); c++) {
        const double size = fabs(q[c] - from[c]);
        moved = fmax(moved, strcmp(s->coordinates[c].unit, "m") ? size : size / *i->length);
        if (!strcmp(s->coordinates[c].unit, "rad") && size > turned) {
            turned = size;
            worst = c;
        }
    }
    if (turned > TURN)
        return say(i, FAILED,
            "%s, t = %.6g s: %s turned by %.3g rad in one step, more than half a turn; reduce solver.step_size",
            s->name, t, s->coordinates[worst].name, turned);
    if (!projects(i))
        return DONE;
    gap = widest(i, q, v, 0, &row);
    if (gap > TORN * moved && gap > GROSS)
        return say(i, FAILED, "%s, t = %.6g s: a step of %.3g opened %s by %.3g; reduce solver.step_size", s->name, t,
            moved, row_label(i, row, label, sizeof label), gap);
    return DONE;
}

/* What a communication step comes to that takes more work than a call may do. */
static Outcome too_much(Instance *i)
{
    return say(i, FAILED,
        "%s, t = %.6g s: more than %d internal steps in one communication step (steps tried again count; patient ones "
        "count as %d); take shorter communication steps, or increase solver.step_size or the tolerances",
        i->scene->name, *instance_time(i), MOST_STEPS, PATIENT_STEP);
}

/* q and v in the workspace brought back to the constraints. */
static Outcome closed_again(Instance *i, double t)
{
    const Scene *s = i->scene;
    const double *after = field(i, s->after);
    char label[100];
    int row;
    run(i, s->close);
    for (int of_velocity = 0; of_velocity < 2; of_velocity++) {
        const double worst = widest(i, after, after + s->n, of_velocity, &row);
        if (!(worst <= GROSS))
            return say(i, OPEN,
                "%s, t = %.6g s: %s = %.1e at %s > %.0e after %d corrections; %s", s->name, t,
                of_velocity ? "|Phi-dot|" : "|Phi|", worst, row_label(i, row, label, sizeof label), GROSS,
                CORRECTIONS, remedy(i));
    }
    return DONE;
}

/* The largest |Phi| and |Phi-dot| after a step that does not end with projections. */
static void watch_gaps(Instance *i)
{
    const Scene *s = i->scene;
    const size_t used = i->used, l = (size_t)s->l;
    const double *q = field(i, s->after);
    double *phi = take(i, l), *cv = take(i, l), *c = i->counts;
    constraints_at(i, q, q + s->n, NULL, NULL, phi, cv);
    for (int r = 0; r < s->l; r++)
        if (i->penalty[r] > 0.0) {
            c[POSITION_ERROR] = fmax(c[POSITION_ERROR], fabs(phi[r]));
            c[VELOCITY_ERROR] = fmax(c[VELOCITY_ERROR], fabs(cv[r]));
        }
    i->used = used;
}

/* S2 to S5: one internal step by loops that stop on convergence, and whether it came near a singular position. */
static Outcome follow(Instance *i, double start, double dt, int *near)
{
    const Scene *s = i->scene;
    const int watch[] = {s->watch1, s->watch2, s->watch3, s->watch4};
    double *m = i->m, *w = i->workspace, *after = m + s->after;
    const double t = start + dt;
    Outcome outcome;
    *near = 0;
    i->left -= PATIENT_STEP;
    if (i->left < 0)
        return too_much(i);
    if (!s->l)
        return say(i, FAILED,
            "%s, t = %.6g s: the state is not finite, or turned by more than half a turn in one step; reduce "
            "solver.step_size",
            s->name, t);
    m[s->dt] = dt;
    at_time(i, start);
    if (i->flags.brakes)
        hold(i);
    run(i, move_by(s, formulation(i)));
    outcome = check_finite(i, start, dt);
    if (outcome != DONE)
        return outcome;
    for (int k = 0; k < 4; k++)
        *near |= w[watch[k] + WATCH_NEAR] != 0.0;
    *near = *near && field(i, s->k)[7] != 0.0;
    if (*near) {
        run(i, s->move_on_branch);
        for (int k = 0; k < 4; k++)
            if (w[watch[k]] == INFINITY) /* What `reached` says of it. */
                return say(i, OPEN,
                    "%s, t = %.6g s: the branch of the motion leaves a constraint open ahead; reduce solver.step_size",
                    s->name, start);
    }
    outcome = check_finite(i, start, dt);
    if (outcome == DONE)
        outcome = check_length(i, t);
    if (outcome == DONE && projects(i))
        outcome = closed_again(i, t);
    else if (outcome == DONE) {
        run(i, s->keep);
        watch_gaps(i);
    }
    if (outcome == DONE && !isfinite(norm(after + s->work + 1, states_of(s))))
        outcome = say(i, FAILED, "%s, t = %.6g s: a state is not finite; reduce solver.step_size", s->name, t);
    for (int k = 0; k < 4 && outcome == DONE; k++)
        outcome = check_converged(i, w + watch[k], t);
    if (outcome != DONE)
        return outcome;
    after[s->trouble] = 0.0;
    arrive(i);
    return DONE;
}

/* S5: an internal step near a singular position in shorter ones. */
static Outcome subdivided(Instance *i, double start, double dt)
{
    const Scene *s = i->scene;
    const double *q = field(i, s->z);
    double t = 0.0, h = dt / 2;
    char where[400] = "";
    int near;
    while (t < dt && h > dt * SHORTEST) {
        const Outcome outcome = follow(i, start + t, h, &near);
        if (outcome == DONE) {
            const double rest = dt - t - h;
            t += h;
            h = fmin(2 * h, rest);
        } else if (outcome == OPEN)
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
    return say(i, FAILED,
        "%s, t = %.6g s: locked up at %s; no motion goes on from this singular position (distance %.1e); turn round "
        "before it, or change lengths or start",
        s->name, start + t, where, sqrt(margin(i)));
}

Outcome watched_step(Instance *i, double start, double dt)
{
    int near;
    const Outcome outcome = follow(i, start, dt, &near);
    if (outcome == OPEN && near)
        return subdivided(i, start, dt);
    return outcome;
}

/* The error of a step of RK4 that led to `whole` in one, and to the state in halves, over the tolerance. Beside a singular
   position velocities count by their energy: in a direction that C hardly holds they are round-off. */
static double halves_error(Instance *i, const double *begin, const double *whole, int near)
{
    const Scene *s = i->scene;
    const double *z = i->m + s->z, *k = i->m + s->k, relative = k[SETTINGS_RELATIVE];
    double found = 0.0, kinetic, other;
    for (int c = 0; c < s->time; c++) {
        const char *unit = c < 2 * s->n ? s->coordinates[c % s->n].unit : "";
        const double size = fmax(fmax(fabs(begin[c]), fabs(z[c])), fabs(whole[c]));
        const double one = !strcmp(unit, "m") ? *i->length : 1.0, most = *unit && c < s->n && strcmp(unit, "1") ? one : size;
        const double allowed = (*unit ? k[SETTINGS_ABSOLUTE] * one : 0.0) + relative * fmin(size, most);
        if (*unit ? !near || c < s->n : c > s->work)
            found = fmax(found, fabs(z[c] - whole[c]) / (allowed + ROUND_OFF * size + DBL_MIN));
    }
    if (near) {
        energy(i, z + s->n, &kinetic);
        energy(i, whole + s->n, &other);
        found = fmax(found, fabs(kinetic - other) / (2.0 * relative * kinetic + DBL_MIN));
    }
    return found / 15.0; /* by extrapolation */
}

/* What is said where the caller of a run ends it within a communication step. */
static Outcome interrupted(Instance *i)
{
    return say(i, FAILED, "%s, t = %.6g s: interrupted", i->scene->name, *instance_time(i));
}

/* The length of what is left of a communication step or up to an event, from which on no error control is of use: methods
   that have one leave it to RK4. A host that sums up its steps makes such a last one of what its sum lacks. */
double brief(const Instance *i)
{
    return fmax(LEFT_TO_RK4 * GIVEN_UP, LAST_DIGITS * DBL_EPSILON * fabs(i->m[i->scene->z + i->scene->time]));
}

/* A step of RK4, whatever the method of the scene: by the kernel, or by loops that stop on convergence. */
Outcome plain_step(Instance *i, double start, double dt)
{
    Outcome outcome;
    i->left--;
    if (i->flags.brakes)
        hold(i);
    if (i->flags.fast && advance(i, 1, dt) == 1)
        return DONE;
    outcome = watched_step(i, start, dt);
    i->counts[PATIENT_STEPS] += outcome == DONE;
    return outcome;
}

/* A step of RK4 by loops that stop on convergence, so long that its error is within the tolerance, where the method of the
   scene cannot go on; beside a singular position round-off can leave more, and then within the tolerance of the run. */
static Outcome robust_step(Instance *i, double end)
{
    const Scene *s = i->scene;
    const size_t used = i->used, size = state_length(s) * sizeof(double);
    double *z = field(i, s->z), *begin = take(i, state_length(s)), *whole = take(i, state_length(s));
    const double start = *instance_time(i), left = end - start;
    const int near = field(i, s->after)[s->near] != 0.0;
    const Mark mark = tape_mark(i);
    double h = fmin(left, i->values[s->step_size]), error = INFINITY, before;
    Outcome outcome = FAILED;
    memcpy(begin, z, size);
    for (; h >= fmin(GIVEN_UP, left) && i->left > 0 && !ended(i); h *= SHORTENED) {
        before = error;
        error = INFINITY;
        outcome = watched_step(i, start, h);
        if (outcome == DONE) {
            memcpy(whole, z, size);
            memcpy(z, begin, size);
            tape_cut(i, mark);
            outcome = watched_step(i, start, h / 2);
            if (outcome == DONE)
                outcome = watched_step(i, start + h / 2, h / 2);
            error = outcome == DONE ? halves_error(i, begin, whole, near) : INFINITY;
        }
        if (error <= 1.0 || (error >= before && error * s->share <= 1.0))
            break;
        memcpy(z, begin, size);
        tape_cut(i, mark);
        outcome = outcome == DONE ? ENDED : outcome; /* It could be made. */
    }
    i->used = used;
    if (outcome == DONE) {
        i->counts[PATIENT_STEPS] += 2.0;
        at_time(i, h < left * (1 - ONE_STEP) ? start + h : end);
        field(i, s->pace)[PACE_DT] = h;
        field(i, s->pace)[PACE_LAST] = 0.0; /* What the method keeps from step to step does not lead on from here. */
        return DONE;
    }
    if (i->ended)
        return interrupted(i);
    if (i->left <= 0)
        return too_much(i);
    if (near && outcome != ENDED)
        return outcome;
    if (!moving(i))
        return say(i, FAILED,
            "%s, t = %.6g s: the motion cannot begin: accelerations jump here or are not finite, or constraints cannot be kept; "
            "check forces, laws and constraints at this time%s",
            s->name, start, or_penalty(i));
    return say(i, FAILED,
        "%s, t = %.6g s: no step however short meets the tolerance; raise solver.relative_tolerance, or use smaller "
        "inputs%s",
        s->name, start, or_penalty(i));
}

/* Steps by the method of the scene up to the end of a communication step, or one of them; those of one length take dt. */
Outcome covered(Instance *i, double end, double dt, int once)
{
    const Scene *s = i->scene;
    double *time = instance_time(i), *pace = field(i, s->pace);
    const double from = *time;
    if (!once)
        pace[PACE_LAST] = 0.0;
    pace[PACE_FIXED] = method(i) == 2 ? dt : 0.0;
    while (*time < end && !(once && *time > from)) {
        if (i->left <= 0)
            return too_much(i);
        if (end - *time <= brief(i)) {
            const Outcome outcome = plain_step(i, *time, end - *time);
            pace[PACE_LAST] = 0.0; /* What the method keeps from step to step does not lead on from here. */
            if (outcome == DONE)
                *time = end;
            return outcome;
        }
        if (i->flags.brakes)
            hold(i);
        if (cover(i, end, once || i->flags.brakes ? 1 : i->left))
            continue;
        if (i->ended)
            return interrupted(i);
        if (method(i) == 1) {
            const Outcome outcome = robust_step(i, end);
            if (outcome != DONE)
                return outcome;
            continue;
        }
        return say(i, FAILED,
            "%s, t = %.6g s: a step by solver.method %s failed; near singular positions, and where constraints stay open, "
            "use explicit or rk4%s",
            s->name, *time, method_name(i), or_penalty(i));
    }
    return DONE;
}

/* How many internal steps a communication step takes at least. */
static double internal_steps(const Instance *i, double h)
{
    return fmax(1.0, ceil(h / i->values[i->scene->step_size] * (1 - 1e-12)));
}

/* Steps from a time to another between which nothing jumps by itself; RK4 made so many of them in one go, and not the next
   one, below zero where it has not tried. */
static Outcome stretch(Instance *i, double start, double end, long made)
{
    const Scene *s = i->scene;
    const double h = end - start, steps = internal_steps(i, h), dt = h / steps;
    double done = 0.0;
    Outcome outcome = DONE;
    at_time(i, start);
    if (s->frictions) {
        field(i, s->pace)[PACE_LAST] = 0.0;
        return friction_cover(i, start, h, dt);
    }
    if (method(i) && !(i->broken && h < LEFT_TO_RK4 * GIVEN_UP))
        return covered(i, end, dt, 0);
    while (done < steps && outcome == DONE) {
        if (ended(i))
            outcome = interrupted(i);
        else if (i->flags.fast && done != (double)made) {
            const double whole = (double)made > done ? (double)made - done : steps - done;
            at_time(i, start + done * dt);
            if (i->flags.brakes)
                hold(i);
            done += (double)advance(i, i->flags.whole ? (long)whole : 1L, dt);
        }
        if (done < steps && outcome == DONE && !i->ended) {
            outcome = watched_step(i, start + done * dt, dt);
            i->counts[PATIENT_STEPS] += outcome == DONE;
            done += 1.0;
        }
    }
    return outcome;
}

/* The last digits of a time in which something jumps by itself: an impact, where that is the rate of a law. */
static Outcome passed(Instance *i, double to)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *q = field(i, s->z), *v = q + s->n, *energies = take(i, 4);
    const double dt = to - *instance_time(i);
    Outcome outcome = DONE;
    int row;
    for (int c = 0; c < dependent(s); c++)
        q[c] += dt * v[c];
    at_time(i, to);
    i->onward = 0; /* What was read is of before. */
    peaks_broken(i);
    if (s->timed && s->l && projects(i) && !(widest(i, q, v, 1, &row) <= GROSS)) {
        energy_into(i, v, energies);
        outcome = projected(i, q, v);
        worked_at_once(i, energies);
    }
    i->used = used;
    return outcome;
}

/* A communication step that the kernel cannot make in one go: it made so many internal steps, and not the next one; below
   zero where it has not tried. */
static Outcome slow_step(Instance *i, double start, double h, long made)
{
    const Scene *s = i->scene;
    const size_t size = state_length(s) * sizeof(double), count = (size_t)(s->past + s->past_size - s->pace);
    double *z = field(i, s->z), *begin = field(i, s->begin), *pace = field(i, s->pace), *before = take(i, count);
    double from = start;
    Outcome outcome = DONE;
    memcpy(begin, z, size);
    memcpy(before, pace, count * sizeof *pace);
    if (!method(i) || i->flags.brakes) /* Steps go on with other numbers than those that were read with. */
        i->onward = 0;
    at_time(i, start);
    if (s->reach >= 0)
        run(i, s->reach);
    for (int k = 0; k <= i->broken && outcome == DONE; k++) {
        const double *about = k < i->broken ? i->breaks + 2 * k : NULL, to = about ? fmin(about[0], start + h) : start + h;
        if (to > from)
            outcome = stretch(i, from, to, made);
        if (about && outcome == DONE)
            outcome = passed(i, from = fmax(from, fmin(about[1], start + h)));
    }
    if (outcome == DONE) {
        at_time(i, start + h);
    } else {
        memcpy(z, begin, size);
        count_turns(i);
        memcpy(pace, before, count * sizeof *pace);
    }
    return outcome;
}

/* Whether a host's time is the one here: to a millionth of the step, or to what a host with numbers of 32 bits has of it. */
static int is_now(Instance *i, double start, double h)
{
    const double time = *instance_time(i), apart = fabs(start - time);
    if (!isfinite(start) || apart <= 1e-6 * h + 1e-12 * fabs(time))
        return isfinite(start);
    if (!(fabs(start) < FLT_MAX && (double)(float)start == start && apart <= FLT_EPSILON * fmax(fabs(start), fabs(time))))
        return 0;
    warn(i, WARNED_OF_TIME,
        "%s, t = %.9g s: the host steps from %.9g s, as a time of 32 bits has it; steps begin where the host says, and laws of "
        "time are followed to %.0e s; keep the time in 64 bits to follow them exactly",
        i->scene->name, time, start, FLT_EPSILON * fabs(start));
    return 1;
}

/* Where a run begins, and the time past which the host does not step. */
Outcome instance_begin(Instance *i, double start, double stop)
{
    if (!(stop >= start))
        return say(
            i, REFUSED, "%s: the stop time is %g s; it must not be before the start at %g s", i->scene->name, stop, start);
    *instance_time(i) = start;
    i->stop = stop;
    return DONE;
}

/* DONE, or why a communication step cannot be made from here, or not by one call. */
Outcome instance_can_step(Instance *i, double start, double h)
{
    const Scene *s = i->scene;
    const double time = *instance_time(i), steps = internal_steps(i, h);
    if (!(isfinite(h) && h > 0.0))
        return say(
            i, REFUSED, "%s, t = %.6g s: a communication step of %g s; it must be above zero", s->name, time, h);
    if (!is_now(i, start, h))
        return say(i, REFUSED, "%s: a step from t = %g s is asked for, but the state is at t = %g s", s->name, start,
            time);
    if (!(steps <= MOST_STEPS))
        return say(i, REFUSED,
            "%s, t = %.6g s: a communication step of %g s takes %.3g internal steps, more than %d; take shorter "
            "communication steps, or increase solver.step_size (%g s)",
            s->name, time, h, steps, MOST_STEPS, i->values[s->step_size]);
    if (start + h > i->stop && start + h - i->stop > 1e-6 * h + FLT_EPSILON * fabs(i->stop))
        return say(i, ENDED,
            "%s, t = %.6g s: a step of %g s leads past the stop time of %g s that the host gave; end the run there, or give "
            "a later stop time or none",
            s->name, time, h, i->stop);
    /* A step that is lost itself moves nothing that a number could show. */
    if (!(start + h / steps > (steps > 1.0 ? nextafter(start, INFINITY) : start)) && h > LEFT_TO_RK4 * GIVEN_UP)
        return say(i, REFUSED,
            "%s, t = %.6g s: steps of %g s are lost in the last digit of the time; take longer ones, or begin at 0",
            s->name, time, h / steps);
    return DONE;
}

/* How many numbers stand from the internal step to past inputs: what steps remember beside the motion. */
static size_t told(const Scene *s)
{
    return (size_t)(s->past + s->past_size - s->dt);
}

/* What a step may change is kept, beside the state at its begin, which the step keeps itself. */
static void remember_step(Instance *i)
{
    const Scene *s = i->scene;
    double *to = i->before;
    memcpy(to, i->slopes, (size_t)(s->inputs + 1) * sizeof *to);
    memcpy(to += s->inputs + 1, i->m + s->u, (size_t)s->inputs * sizeof *to);
    memcpy(to += s->inputs, i->counts, COUNTED * sizeof *to);
    memcpy(to + COUNTED, i->m + s->dt, told(s) * sizeof *to);
}

static void step_back(Instance *i)
{
    const Scene *s = i->scene;
    const double *from = i->before;
    memcpy(i->m + s->z, i->m + s->begin, state_length(s) * sizeof *from);
    count_turns(i);
    memcpy(i->slopes, from, (size_t)(s->inputs + 1) * sizeof *from);
    memcpy(i->m + s->u, from += s->inputs + 1, (size_t)s->inputs * sizeof *from);
    memcpy(i->counts, from += s->inputs, COUNTED * sizeof *from);
    memcpy(i->m + s->dt, from + COUNTED, told(s) * sizeof *from);
    i->flags.known = 0;
}

/* A communication step and the outputs at its end, without which it is not made. */
static Outcome whole_step(Instance *i, double start, double h)
{
    const Scene *s = i->scene;
    Outcome outcome = DONE;
    long made = -1;
    /* Methods beside RK4 may need any number of steps, which the slower way counts; it takes no step back along which
       derivatives were led, either. */
    if (!i->flags.whole || method(i) || s->frictions || s->entries || i->broken || !communicate(i, start, h, &made))
        outcome = slow_step(i, start, h, made);
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
        tell_step_error(i);
    }
    return outcome == DONE && s->entries ? jacobian_end(i) : outcome;
}

/* DONE where what happens by itself up to an end lets a step be made, and when that is. */
static Outcome looked_ahead(Instance *i, double start, double end)
{
    const Outcome outcome = breaks_found(i, start, end);
    return outcome == DONE ? laws_checked(i, end) : outcome;
}

/* DONE where a communication step can begin: what the Boolean inputs ask for is in force. Nothing has changed otherwise, but
   that they ask for nothing. */
Outcome instance_ready(Instance *i, double start, double h)
{
    Outcome outcome = DONE;
    if (!i->flags.initialized)
        return say(i, REFUSED, "%s: initialise before the first step", i->scene->name);
    outcome = instance_can_step(i, start, h);
    if (outcome == DONE && i->scene->followed_count && !i->within) {
        outcome = signals_aim(i, start, h);
        parameters(i);
        i->flags.known = 0;
    }
    if (outcome == DONE && !i->flags.pending)
        return looked_ahead(i, start, start + h);
    if (outcome != DONE)
        return outcome;
    i->used = 0;
    instance_remember(i);
    hand_over(i);
    outcome = take_effect(i);
    if (outcome == DONE)
        outcome = looked_ahead(i, start, start + h);
    if (outcome != DONE) {
        instance_go_back(i);
        memcpy(i->wanted, i->on, (size_t)i->scene->switches * sizeof *i->on);
        i->flags.pending = 0;
    }
    i->used = 0;
    return outcome;
}

/* Signals as they were before a step that is not made. */
static void signals_back(Instance *i)
{
    const Scene *s = i->scene;
    if (!s->followed_count)
        return;
    memcpy(i->kept, i->kept_before, (size_t)s->held * sizeof *i->kept);
    memcpy(i->heard, i->kept_before + s->held, (size_t)s->followed_count * HEARD * sizeof *i->heard);
    parameters(i);
}

static Outcome stepped(Instance *i, double start, double h)
{
    const Scene *s = i->scene;
    const int changed = i->flags.pending || s->frictions, pending = i->flags.pending;
    Outcome outcome;
    if (s->followed_count) {
        memcpy(i->kept_before, i->kept, (size_t)s->held * sizeof *i->kept);
        memcpy(i->kept_before + s->held, i->heard, (size_t)s->followed_count * HEARD * sizeof *i->heard);
    }
    outcome = instance_ready(i, start, h);
    if (outcome != DONE) {
        signals_back(i);
        return outcome;
    }
    if (changed && !pending) /* What sticks may change in a step. */
        instance_remember(i);
    i->used = 0;
    if (!i->within)
        i->left = MOST_STEPS, i->crossings = 0;
    if (!changed)
        remember_step(i);
    i->slopes[0] = start;
    hand_over(i);
    if (s->peaks && !i->within)
        peaks_begin(i);
    outcome = whole_step(i, start, h);
    if (outcome != DONE && changed)
        instance_go_back(i);
    else if (outcome != DONE)
        step_back(i);
    if (outcome != DONE)
        signals_back(i);
    i->used = 0;
    return outcome;
}

Outcome instance_step(Instance *i, double start, double h)
{
    Outcome outcome;
    if (!i->scene->entries || i->tape) /* A run with derivatives has a tape of its own. */
        return stepped(i, start, h);
    outcome = jacobian_begin(i);
    if (outcome == DONE)
        outcome = stepped(i, start, h);
    i->tape = NULL;
    return outcome;
}

/* Outputs ---------------------------------------------------------------------------------------------------------- */

/* The first output that is not finite, with its value; NULL where all are. */
static const char *not_finite(const Instance *i, double *value)
{
    const Scene *s = i->scene;
    const double *seen = i->m + s->seen;
    const int first = outputs_from(s);
    for (int k = 0; k < s->outputs; k++)
        if (!isfinite(*value = instance_get(i, first + k)))
            return s->variables[first + k].name;
    for (int k = s->outputs - s->event_count; k < s->seen_size; k++)
        if (!isfinite(*value = seen[k]))
            return "|Phi-ddot|";
    return NULL;
}

/* Whether all outputs are finite, as `not_finite` finds it: zero times what is not finite is not a number. */
static int all_finite(const Instance *i)
{
    const Scene *s = i->scene;
    const double *seen = i->m + s->seen;
    double sums[4] = {0.0, 0.0, 0.0, 0.0}, events = *i->lost * 0.0;
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

/* The largest errors that were read; not a number where nobody watches. */
static void watch_errors(Instance *i)
{
    const Scene *s = i->scene;
    const double *seen = field(i, s->seen);
    double *c = i->counts;
    c[READS] += 1.0;
    c[POSITION_ERROR] = s->monitor_position < 0 ? NAN : fmax(c[POSITION_ERROR], seen[s->monitor_position]);
    c[VELOCITY_ERROR] = s->monitor_velocity < 0 ? NAN : fmax(c[VELOCITY_ERROR], seen[s->monitor_velocity]);
    c[ACCELERATION_ERROR] = fmax(c[ACCELERATION_ERROR], verdict(i, SEEN_ACCELERATION_ERROR));
    c[ENERGY_ERROR] = s->monitor_energy < 0
        ? NAN
        : fmax(c[ENERGY_ERROR],
              fabs(seen[s->monitor_energy] - c[ENERGY_START] - field(i, s->z)[s->work]));
}

/* What can be read at this instant, by loops that stop on convergence. */
static Outcome read_patiently(Instance *i)
{
    const Scene *s = i->scene;
    const int instant = instant_by(s, formulation(i));
    Outcome outcome = DONE;
    int limited = 0;
    double value;
    i->iterations = 0;
    run(i, instant);
    if (verdict(i, SEEN_NEAR) != 0.0 && s->limit_patient >= 0) {
        run(i, s->limit_patient);
        limited = !not_finite(i, &value);
        if (!limited)
            run(i, instant);
    }
    if (s->l && instant != s->instant && !limited)
        outcome = check_converged(i, i->workspace + s->watch0, *instance_time(i));
    if (s->monitor_iterations >= 0 && i->iterations > 0)
        i->m[s->seen + s->monitor_iterations] = i->iterations;
    return outcome;
}

/* Whether what can be read here has been read, away from any pole. */
int read_away(Instance *i)
{
    const Scene *s = i->scene;
    if (!(i->flags.fast && read_quickly(i)))
        run(i, instant_by(s, formulation(i)));
    return all_finite(i) && verdict(i, SEEN_NEAR) == 0.0;
}

Outcome instance_read(Instance *i)
{
    const Scene *s = i->scene;
    const double *z = field(i, s->z);
    Outcome outcome = DONE;
    const char *name = NULL;
    char closer[120];
    double value;
    if (i->flags.known)
        return DONE;
    i->used = 0;
    if (i->tape)
        i->tape->reading = i->tape->used;
    hand_over(i);
    if (i->flags.brakes)
        hold(i);
    if (!(i->flags.fast && read_quickly(i) && all_finite(i))) {
        outcome = read_patiently(i);
        name = not_finite(i, &value);
    }
    if (outcome != DONE)
        return outcome;
    i->flags.known = !name;
    if (!name) {
        watch_errors(i);
        tell_step_error(i);
        return DONE;
    }
    if (jammed(i))
        return say_jam(i);
    if (instant_by(s, formulation(i)) != s->instant)
        outcome = explained(i, z, z + s->n, z[s->time], i->workspace[s->watch0 + WATCH_PIVOT]);
    if (outcome != DONE)
        return outcome;
    return say(i, FAILED,
        "%s, t = %.6g s: %s would be %g, as accelerations and reactions cannot be computed here; use smaller inputs%s%s%s",
        s->name, *instance_time(i), name, unsigned_nan(value),
        moving(i) ? ", another start or a smaller solver.step_size" : " or another start", or_penalty(i), or_compliances(i, closer, sizeof closer));
}

/* Outputs (readings) that the inputs in `direction` change, by a difference: exact where they change evenly. */
static void differences(Instance *i, const double *direction, double *change)
{
    const Scene *s = i->scene;
    const int instant = instant_by(s, formulation(i));
    double *u = field(i, s->u), *seen = field(i, s->seen), *before = take(i, (size_t)s->inputs);
    const double share = s->frictions ? SMALL_CHANGE : 1.0; /* Loads of friction do not change evenly. */
    memcpy(before, u, (size_t)s->inputs * sizeof *u);
    memset(change, 0, (size_t)s->readings * sizeof *change);
    for (int side = -1; side < 2; side += 2) {
        for (int k = 0; k < s->inputs; k++)
            u[k] = before[k] + side * share * direction[k];
        run(i, instant);
        for (int k = 0; k < s->readings; k++)
            change[k] += side * seen[k] / (2 * share);
    }
    memcpy(u, before, (size_t)s->inputs * sizeof *u);
    run(i, instant);
}

Outcome instance_derivative(Instance *i, const unsigned *unknowns, size_t unknown_count, const unsigned *knowns,
    size_t known_count, const double *directions, double *changes)
{
    const Scene *s = i->scene;
    const int first = s->parameters + s->choices, outputs = outputs_from(s);
    double *w = i->workspace;
    i->used = 0;
    hand_over(i);
    memset(changes, 0, unknown_count * sizeof *changes);
    if (s->sensitivity < 0)
        return DONE;
    if (i->flags.brakes)
        hold(i);
    memset(w + s->du, 0, (size_t)s->inputs * sizeof *w);
    for (size_t k = 0; k < known_count; k++)
        w[s->du + (int)knowns[k] - first] += directions[k];
    if ((s->l && formulation(i) > CLASSIC_FORMULATION) || s->frictions)
        differences(i, w + s->du, w + s->dy);
    else /* Where a limit is read, its derivative is. */
        run(i, verdict(i, SEEN_NEAR) != 0.0 && s->limit_sensitivity >= 0 ? s->limit_sensitivity
                                                                                    : s->sensitivity);
    for (size_t k = 0; k < unknown_count; k++)
        if ((int)unknowns[k] - outputs < s->readings)
            changes[k] = w[s->dy + (int)unknowns[k] - outputs];
    for (size_t k = 0; k < unknown_count; k++)
        if (!isfinite(changes[k]))
            return say(i, FAILED, "%s, t = %.6g s: directional derivatives cannot be computed here", s->name,
                *instance_time(i));
    return DONE;
}

/* Places after now, in internal steps, that derivatives of outputs are differences of, and their weights. */
#define PLACES 5
#define APART 0.03125
static const double difference[2][PLACES] = {
    {-25.0 / 12, 4.0, -3.0, 4.0 / 3, -1.0 / 4},
    {35.0 / 12, -26.0 / 3, 19.0 / 2, -14.0 / 3, 11.0 / 12},
};

/* Time derivatives of outputs as the motion goes on from here, with the inputs as they are and go on by themselves: one-
   sided differences of order 4 (first derivatives) and 3 (second ones) of a short motion, which is then taken back.
   Boolean inputs that have not yet taken effect do not count. */
Outcome instance_output_derivatives(
    Instance *i, const unsigned *references, const int *orders, size_t count, double *values)
{
    const Scene *s = i->scene;
    const double start = *instance_time(i), h = APART * i->values[s->step_size];
    Outcome outcome = DONE;
    instance_remember(i);
    i->left = MOST_STEPS;
    i->flags.pending = 0;
    i->slopes[0] = start;
    memset(values, 0, count * sizeof *values);
    for (int k = 0; outcome == DONE && k < PLACES; k++) {
        if (k) {
            i->used = 0;
            i->within = k > 1;
            hand_over(i);
            outcome = slow_step(i, start + (k - 1) * h, h, -1);
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
    i->used = 0;
    for (size_t each = 0; outcome == DONE && each < count; each++)
        if (!isfinite(values[each]))
            outcome = say(i, FAILED, "%s, t = %.6g s: derivative %d of %s would be %g", s->name, start, orders[each],
                s->variables[references[each]].name, unsigned_nan(values[each]));
    return outcome;
}

/* State ------------------------------------------------------------------------------------------------------------ */

typedef struct {
    unsigned magic, format, sum; /* a check sum of the whole state with zero in its place */
    size_t count;
    char guid[48];
    Flags flags;
} Head;

static Head head(const Instance *i)
{
    Head h;
    memset(&h, 0, sizeof h);
    h.magic = MAGIC;
    h.format = FORMAT;
    h.count = i->count;
    strncpy(h.guid, i->scene->guid, sizeof h.guid - 1);
    h.flags = i->flags;
    h.flags.known = 0; /* What is restored is read again. */
    return h;
}

size_t state_size(const Instance *i)
{
    return sizeof(Head) + i->count * sizeof *i->numbers;
}

/* The check sum of a saved state, as it was when it was saved. */
static unsigned state_sum(const unsigned char *state, size_t size)
{
    const unsigned nothing = 0;
    const size_t at = offsetof(Head, sum);
    unsigned sum = check_sum_from(CHECK_BEGIN, state, at);
    sum = check_sum_from(sum, (const unsigned char *)&nothing, sizeof nothing);
    return ~check_sum_from(sum, state + at + sizeof nothing, size - at - sizeof nothing);
}

void state_save(const Instance *i, unsigned char *state)
{
    const Scene *s = i->scene;
    const double *memory = i->m;
    const struct {
        const double *numbers;
        size_t count;
    } scratch[] = {{memory + s->after, state_length(s)}, {memory + s->begin, state_length(s)},
        {memory + s->seen, (size_t)s->seen_size}, {i->slopes, 1}};
    Head h = head(i);
    memcpy(state + sizeof h, i->numbers, i->count * sizeof *i->numbers);
    /* What steps and reading leave behind, and nothing depends on. */
    for (size_t k = 0; k < sizeof scratch / sizeof *scratch; k++)
        memset(state + sizeof h + (size_t)(scratch[k].numbers - i->numbers) * sizeof(double), 0,
            scratch[k].count * sizeof(double));
    memcpy(state, &h, sizeof h);
    h.sum = state_sum(state, state_size(i));
    memcpy(state, &h, sizeof h);
}

/* Whether a saved state is one of this mechanism that has not changed since. */
int state_whole(const Instance *i, const unsigned char *state, size_t size)
{
    const Head mine = head(i);
    Head h;
    if (size != state_size(i))
        return 0;
    memcpy(&h, state, sizeof h);
    return h.magic == mine.magic && h.format == mine.format && h.count == mine.count
        && !memcmp(h.guid, mine.guid, sizeof h.guid) && h.sum == state_sum(state, size);
}

static Outcome unsound(Instance *i, const char *what, double value)
{
    return say(i, REFUSED, "%s: %s of the saved state is %g, which no run has; save it again", i->scene->name, what,
        value);
}

/* DONE, or what in the state just restored was never that of an instance: numbers that index or bound anything first. */
static Outcome sound(Instance *i)
{
    const Scene *s = i->scene;
    const Flags *f = &i->flags;
    const Variable *inputs = s->variables + s->parameters + s->choices;
    const double *control = field(i, s->control);
    const int flags[] = {f->initialized, f->known, f->scaled, f->fast, f->whole, f->pending, f->brakes,
        f->warned & ~EVERY_WARNING};
    const struct {
        const char *name;
        const double *numbers;
        int count;
    } parts[] = {
        {"the motion", field(i, s->z), (int)state_length(s)},
        {"a parameter", field(i, s->p), s->own + s->held},
        {"a penalty", i->penalty, s->l},
        {"a penalty", i->full, s->l},
        {"a unit", i->units, s->l},
        {"a scale", i->scales, s->n},
        {"a length", i->length, 1},
        {"a compliance", i->compliances, s->compliances},
        {"a lock", i->kept, s->held},
        {"a signal", i->heard, s->followed_count * HEARD},
        {"an impulse", i->impulses, s->impulses},
        {"energy lost", i->lost, 1},
        {"a derivative of the last step", i->jacobian, s->entries},
        {"a peak", i->peaks, (int)peaks_length(s)},
        {"a step size", control, 1},
        {"a past input", field(i, s->past), s->past_size},
    };
    for (size_t k = 0; k < sizeof flags / sizeof *flags; k++)
        if (flags[k] != 0 && flags[k] != 1)
            return unsound(i, "a flag", flags[k]);
    for (int k = 0; k < s->choices; k++)
        if (f->choice[k] < 0 || f->choice[k] >= s->choice[k].count)
            return unsound(i, s->variables[s->parameters + k].name, f->choice[k]);
    for (int k = 0; k < s->parameters; k++)
        if (checked(i, s->variables + k, i->values[k]) != DONE)
            return unsound(i, s->variables[k].name, i->values[k]);
    for (int k = 0; k < s->inputs; k++)
        if (checked(i, inputs + k, i->m[s->u + k]) != DONE)
            return unsound(i, inputs[k].name, i->m[s->u + k]);
    for (int k = 0; k < s->inputs; k++)
        if (i->slopes[1 + k] != s->no_slope && !isfinite(i->slopes[1 + k]))
            return unsound(i, "the derivative of an input", i->slopes[1 + k]);
    for (int k = 0; k < s->switches; k++)
        if ((i->wanted[k] != 0.0 && i->wanted[k] != 1.0) || (i->on[k] != 0.0 && i->on[k] != 1.0))
            return unsound(i, inputs[s->inputs + k].name, i->wanted[k]);
    if (!(f->phase & ANY) || (f->phase & (f->phase - 1)) || (f->phase & RUN && !f->initialized))
        return unsound(i, "the phase", f->phase);
    for (int k = 0; k < s->followed_count; k++)
        for (int each = 0; each < 2; each++) {
            const double count = i->heard[k * HEARD + each];
            if (!(count >= 0.0 && count <= (each ? 2 : HEARD_POINTS) && count == floor(count)))
                return unsound(i, "what is heard of an input", count);
        }
    for (int k = 0; k < s->frictions; k++) {
        const double slip = i->kept[s->friction[k].slip];
        if (f->initialized && slip != 0.0 && fabs(slip) != 1.0 && fabs(slip) != LIMITED && slip != SHARED)
            return unsound(i, "the direction of friction", slip);
    }
    if (!isfinite(*instance_time(i)))
        return unsound(i, "the time", *instance_time(i));
    if (!f->initialized) /* What follows is found when a run begins. */
        return DONE;
    for (size_t part = 0; part < sizeof parts / sizeof *parts; part++)
        for (int k = 0; k < parts[part].count; k++)
            if (!isfinite(parts[part].numbers[k]))
                return unsound(i, parts[part].name, parts[part].numbers[k]);
    if (control[CONTROL_STEP_SIZE] != i->values[s->step_size] ||
        (control[CONTROL_TIER] != 0.0 && control[CONTROL_TIER] != 1.0))
        return unsound(i, "the first tier", control[CONTROL_TIER]);
    if (control[CONTROL_METHOD] != method(i))
        return unsound(i, "the method", control[CONTROL_METHOD]);
    return DONE;
}

/* Nothing has changed where a state is refused. */
Outcome state_restore(Instance *i, const unsigned char *state, size_t size)
{
    Head h;
    Outcome outcome;
    if (!state_whole(i, state, size))
        return say(i, REFUSED,
            "%s: the saved state is not one of this mechanism, or has changed since (check sum); save it again",
            i->scene->name);
    memcpy(&h, state, sizeof h);
    instance_remember(i);
    i->flags = h.flags;
    memcpy(i->numbers, state + sizeof h, i->count * sizeof *i->numbers);
    outcome = sound(i);
    if (outcome != DONE)
        instance_go_back(i);
    return outcome;
}

/* Penalties ------------------------------------------------------------------------------------------------------- */

Outcome instance_penalize(Instance *i, const double *penalties)
{
    const Scene *s = i->scene;
    Outcome outcome;
    for (int r = 0; r < s->l; r++)
        if (!(isfinite(penalties[r]) && penalties[r] >= 0.0))
            return say(i, REFUSED, "%s: solver.penalty of constraint %d is %g; it must be a finite number, 0 or above",
                s->name, r + 1, penalties[r]);
    if (!i->flags.initialized) {
        memcpy(i->given, penalties, (size_t)s->l * sizeof *penalties);
        i->flags.given = 1;
        return DONE;
    }
    i->used = 0;
    hand_over(i);
    instance_remember(i);
    memcpy(i->full, penalties, (size_t)s->l * sizeof *penalties);
    i->flags.scaled = 0;
    outcome = change(i, i->on);
    if (outcome != DONE)
        instance_go_back(i);
    i->used = 0;
    return outcome;
}
