/* Driving inputs, which prescribe a motion: within a communication step each follows a polynomial of time.

   The highest given derivative of an input (value, rate or acceleration) is extrapolated by the polynomial of the
   declared order through the newest communication points, which predicts the input at the end of the step. The motion
   reaches the prediction from its present state: by a quintic with the accelerations of both ends if the input's
   acceleration is given, otherwise by a cubic with the rates of both ends. So neither positions nor velocities jump. */

#include "driving_inputs.h"

#include "instance.h"
#include "layout.h"
#include "message.h"
#include "quantity.h"
#include "record.h"
#include "scene.h"

/* Ratio of a step to the previous one [1], up to which the acceleration is kept. */
#define SHORT 1e-6

static double *polynomial_of(const Instance *i, int which)
{
    const Scene *s = i->scene;
    return i->discrete + s->held + (which - s->followed_count) * POLYNOMIAL;
}

static Given read_given(const Instance *i, int which)
{
    const Scene *s = i->scene;
    const Followed *f = s->followed + which;
    const double *u = i->m + s->u + f->input, slope = i->slopes[1 + f->input];
    Given g = {{u[0], 0.0, 0.0}, f->derivatives};
    for (int k = 1; k <= f->derivatives; k++)
        g.value[k] = u[k];
    if (f->derivatives == 0 && slope != s->no_slope) {
        g.value[1] = slope;
        g.level = 1;
    }
    return g;
}

/* Evaluate the value, rate and acceleration of a polynomial at a time. */
static void input_polynomial_at(const double *c, double time, double *found)
{
    const double x = time - c[0];
    found[0] = found[1] = found[2] = 0.0;
    for (int k = POLYNOMIAL - 1; k > 0; k--) {
        found[2] = 2 * found[1] + x * found[2];
        found[1] = found[0] + x * found[1];
        found[0] = c[k] + x * found[0];
    }
}

/* Add a point of an input at a time. It replaces later points, and earlier ones so close that differences would be
   round-off. */
static void append_point(double *heard, const Given *g, double time, double little)
{
    int count = heard[LEVEL] == g->level ? (int)heard[KNOWN_POINTS] : 0, later = 0;
    while (later < count && heard[TIMES + later] >= time - little)
        later++;
    count = count - later < HEARD_POINTS - 1 ? count - later : HEARD_POINTS - 1;
    memmove(heard + TIMES + 1, heard + TIMES + later, (size_t)count * sizeof *heard);
    memmove(heard + VALUES + 1, heard + VALUES + later, (size_t)count * sizeof *heard);
    heard[TIMES] = time;
    heard[VALUES] = g->value[g->level];
    heard[KNOWN_POINTS] = count + 1;
    heard[LEVEL] = g->level;
}

/* Extrapolate an input by h [s]: value, rate, acceleration. */
static void extrapolate_input(const double *heard, const Given *g, int order, double h, double *end)
{
    const double *t = heard + TIMES, *y = heard + VALUES;
    const int degree = order < (int)heard[KNOWN_POINTS] - 1 ? order : (int)heard[KNOWN_POINTS] - 1;
    double c[3] = {y[0], 0.0, 0.0}, power = 1.0; /* coefficients through the known points */
    if (degree > 0)
        c[1] = (y[0] - y[1]) / (t[0] - t[1]);
    if (degree > 1) {
        c[2] = (c[1] - (y[1] - y[2]) / (t[1] - t[2])) / (t[0] - t[2]);
        c[1] += c[2] * (t[0] - t[1]);
    }
    end[0] = end[1] = end[2] = 0.0;
    for (int k = 0; k < 3; k++, power *= h) /* Integrate or differentiate each term. */
        for (int d = 0; d < 3; d++) {
            const int raised = g->level - d; /* number of integrations */
            double term = c[k] * power;
            for (int r = 1; r <= raised; r++)
                term *= h / (k + r);
            for (int r = 0; r < -raised; r++)
                term *= h > 0.0 ? (k - r) / h : 0.0;
            end[d] += term;
        }
    for (int d = 0; d < g->level; d++) { /* Add the given lower derivatives. */
        double term = 1.0;
        for (int k = d; k < g->level; k++, term *= h / (k - d))
            end[d] += g->value[k] * term;
    }
}

void inputs_begin(Instance *i, double time)
{
    const Scene *s = i->scene;
    if (!s->timed)
        return;
    i->discrete[s->held - 1 - s->followed_count * POLYNOMIAL] = time;
    memset(i->input_history, 0, (size_t)s->followed_count * HEARD * sizeof *i->input_history);
    tape_clearing(i, i->input_history, (size_t)s->followed_count * HEARD);
    for (int k = 0; k < s->followed_count; k++) {
        const Given g = read_given(i, k);
        double *c = polynomial_of(i, k);
        memset(c, 0, POLYNOMIAL * sizeof *c);
        c[0] = time;
        c[1] = g.value[0];
        c[2] = g.value[1];
        c[3] = g.value[2] / 2;
        tape_clearing(i, c, POLYNOMIAL);
        for (int each = 0; each <= s->followed[k].derivatives; each++) {
            const double *from[] = {i->m + s->u + s->followed[k].input + each}, half[] = {each == 2 ? 0.5 : 1.0};
            tape_sum(i, c + 1 + each, 1, from, half);
        }
    }
}

/* Find the polynomial of an input for a step of h [s] from `start`, where it continues the previous polynomial. If the
   step is at most `little`, or much shorter than the previous one, it keeps the acceleration: the one that reaches the
   prediction may be arbitrarily large. */
void input_aim(const Followed *f, const Given *g, double *c, double *heard, double start, double h, double little)
{
    double now[3], end[3];
    input_polynomial_at(c, start, now);
    append_point(heard, g, start, little);
    extrapolate_input(heard, g, f->order, h, end);
    memset(c, 0, POLYNOMIAL * sizeof *c);
    c[0] = start;
    c[1] = now[0];
    c[2] = now[1];
    if (h <= little || (heard[KNOWN_POINTS] > 1.0 && h <= SHORT * (heard[TIMES] - heard[TIMES + 1])))
        c[3] = now[2] / 2;
    else if (g->level < 2) {
        const double way = end[0] - now[0];
        c[3] = (3 * way - (2 * now[1] + end[1]) * h) / (h * h);
        c[4] = (-2 * way + (now[1] + end[1]) * h) / (h * h * h);
    } else {
        const double way = end[0] - now[0] - h * (now[1] + h * now[2] / 2);
        const double faster = (end[1] - now[1] - h * now[2]) * h, bent = (end[2] - now[2]) * h * h / 2;
        c[3] = now[2] / 2;
        c[4] = (10 * way - 4 * faster + bent) / (h * h * h);
        c[5] = (-15 * way + 7 * faster - 2 * bent) / (h * h * h * h);
        c[6] = (6 * way - 3 * faster + bent) / (h * h * h * h * h);
    }
}

static void tape_aim(Instance *i, int which, int level, double start, double h);

Outcome inputs_aim(Instance *i, double start, double h)
{
    const Scene *s = i->scene;
    for (int k = 0; k < s->followed_count; k++) { /* Refuse before anything changes. */
        const Variable *v = s->variables + s->parameters + s->choices + s->followed[k].input;
        const double value = read_given(i, k).value[0], limit = s->followed[k].jump;
        double now[3];
        char own[QUANTITY], there[QUANTITY], most[QUANTITY];
        input_polynomial_at(polynomial_of(i, k), start, now);
        if (!(fabs(value - now[0]) <= limit))
            return instance_say(i, REFUSED,
                "%s, t = %.6g s: %s is set to %s, but the motion it prescribes is at %s: a jump of %.3g %s, above the "
                "limit of %s; change it less from one communication step to the next, give its rate too "
                "(derivatives=1 of the input), or declare the input with a larger jump",
                s->name, start, v->name, quantity_in_unit(v->unit, value, own),
                quantity_in_unit(v->unit, now[0], there), fabs(value - now[0]), v->unit,
                quantity_in_unit(v->unit, limit, most));
    }
    for (int k = 0; k < s->followed_count; k++) {
        const Given g = read_given(i, k);
        tape_aim(i, k, g.level, start, h);
        input_aim(
            s->followed + k, &g, polynomial_of(i, k), i->input_history + k * HEARD, start, h, instance_least_step(i));
    }
    return DONE;
}

/* For given times the polynomial is linear in the values of an input: `input_aim` applied to tangents yields its
   tangents. */

static void tape_aim(Instance *i, int which, int level, double start, double h)
{
    const Scene *s = i->scene;
    Entry *e = tape_entry(i, AIMED, which, 3, SAVED);
    double *saved;
    if (!e)
        return;
    saved = i->tape->numbers + e->numbers;
    memcpy(saved, i->input_history + which * HEARD, HEARD * sizeof *saved);
    saved[SAVED_LEVEL] = level;
    saved[SAVED_START] = start;
    saved[SAVED_STEP] = h;
    saved[SAVED_FROM] = polynomial_of(i, which)[0];
    saved[SAVED_LITTLE] = instance_least_step(i);
    i->tape->words[e->words] = tape_place_of(i, polynomial_of(i, which));
    i->tape->words[e->words + 1] = tape_place_of(i, i->input_history + which * HEARD);
    i->tape->words[e->words + 2] = tape_place_of(i, i->m + s->u + s->followed[which].input);
}
