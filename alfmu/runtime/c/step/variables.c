/* Check, set and get values of variables by reference. */

#include "variables.h"

#include <stdio.h>

#include "instance.h"
#include "message.h"
#include "scene.h"
#include "scene_sizes.h"
#include "text.h"

/* Return DONE, or the reason why a variable cannot take a value. */
Outcome variable_check(Instance *i, const Variable *v, double value)
{
    const char *name = i->scene->name;
    char low[32] = "-inf", high[32] = "inf";
    if (v->type == BOOLEAN) {
        if (value == 0.0 || value == 1.0)
            return DONE;
        return instance_say(i, REFUSED, "%s: %s is %g; it must be true or false", name, v->name, value);
    }
    if (!isfinite(value))
        return instance_say(
            i, REFUSED, "%s: %s is %g; it must be a finite number in %s", name, v->name, value, v->unit);
    if (v->type == INTEGER && value != floor(value))
        return instance_say(i, REFUSED, "%s: %s is %g; it must be a whole number", name, v->name, value);
    if (value >= v->minimum && value <= v->maximum)
        return DONE;
    if (v->minimum == v->maximum)
        return instance_say(i, REFUSED,
            "%s: %s is %g, but fixed at %g here; give it where the instance, batch or FMU is made",
            name, v->name, value, v->minimum);
    if (isfinite(v->minimum))
        write_text(low, sizeof low, "%g", v->minimum);
    if (isfinite(v->maximum))
        write_text(high, sizeof high, "%g", v->maximum);
    return instance_say(i, REFUSED, "%s: %s = %g %s is outside [%s, %s]", name, v->name, value, v->unit, low, high);
}

/* Return DONE if a parameter can still be changed. */
Outcome check_changeable(Instance *i, const Variable *v)
{
    if (i->flags.phase & RUN)
        return instance_say(
            i, REFUSED, "%s: %s is fixed once the run has begun; set it before initialising", i->scene->name, v->name);
    i->flags.initialized = 0;
    return DONE;
}

/* Mark the start as outdated after a change of a value: until the run has begun, the next reading repeats it. */
void variable_changed_start(Instance *i, int changed)
{
    if (changed && !(i->flags.phase & RUN))
        i->flags.initialized = 0;
}

Outcome variable_set_choice(Instance *i, int reference, double value)
{
    const Scene *s = i->scene;
    const Choice *choice = s->choice + (reference - s->parameters);
    char known[400] = "";
    Outcome outcome;
    if (value >= 1.0 && value <= choice->count && value == floor(value)) {
        outcome = check_changeable(i, s->variables + reference);
        if (outcome == DONE)
            i->flags.choice[reference - s->parameters] = (int)value - 1;
        return outcome;
    }
    for (int k = 0; k < choice->count; k++) {
        char part[64];
        snprintf(part, sizeof part, "%s%d (%.40s)", k ? ", " : "", k + 1, choice->values[k]);
        strncat(known, part, sizeof known - strlen(known) - 1);
    }
    return instance_say(
        i, REFUSED, "%s: %s is %g; this native FMU supports %s", s->name, s->variables[reference].name, value, known);
}

Outcome variable_set_switch(Instance *i, int reference, double value)
{
    const Scene *s = i->scene;
    double *requested_value = i->requested + (reference - s->parameters - s->choices - s->inputs);
    variable_changed_start(i, value != *requested_value);
    *requested_value = value;
    i->flags.pending = 0;
    for (int k = 0; k < s->switches; k++)
        i->flags.pending |= i->requested[k] != i->active[k];
    return DONE;
}

/* Set zeta and omega [1/s] of (5), (6) and Baumgarte's form of (9), and whether steps end with projections (10); a
   negative `projection` leaves this to the formulation. A scene has no variables for them; the binding sets them. */
Outcome instance_stabilise(Instance *i, double zeta, double omega, int projection)
{
    if (i->flags.phase & RUN)
        return instance_say(i, REFUSED,
            "%s: zeta, omega and the projection are fixed once the run has begun; set them before "
            "initialising",
            i->scene->name);
    if (!isfinite(zeta) || !isfinite(omega))
        return instance_say(
            i, REFUSED, "%s: zeta = %g, omega = %g; they must be finite numbers", i->scene->name, zeta, omega);
    i->stabilisation[0] = zeta;
    i->stabilisation[1] = omega;
    *i->projection = projection;
    i->flags.initialized = 0;
    return DONE;
}

/* Set the time derivative of an input in the next communication step. */
Outcome instance_set_slope(Instance *i, int reference, double value)
{
    const Scene *s = i->scene;
    if (!isfinite(value))
        return instance_say(i, REFUSED, "%s: the derivative of %s is %g; it must be a finite number", s->name,
            s->variables[reference].name, value);
    variable_changed_start(i, value != i->slopes[1 + reference - s->parameters - s->choices]);
    i->slopes[1 + reference - s->parameters - s->choices] = value;
    return DONE;
}

/* Return the address of a variable's value; NULL for a choice. */
static inline const double *value_address(const Instance *i, int reference)
{
    const Scene *s = i->scene;
    const int output = reference - scene_first_output(s), event = output - (s->outputs - s->event_count);
    if (output >= s->outputs + s->entries)
        return i->exchange + (output - s->outputs - s->entries);
    if (output >= s->outputs)
        return i->jacobian + (output - s->outputs);
    if (event >= 0)
        return s->event_places[event] < s->impulses ? i->impulses + s->event_places[event]
            : s->event_places[event] == s->impulses ? i->dissipated
                                                    : i->peaks + (s->event_places[event] - s->impulses - 1);
    if (output >= 0)
        return i->m + s->seen + output;
    if (reference < s->parameters)
        return i->values + reference;
    reference -= s->parameters;
    if (reference < s->choices)
        return NULL;
    reference -= s->choices;
    return reference < s->inputs ? i->m + s->u + reference : i->requested + (reference - s->inputs);
}

static inline double value_of(const Instance *i, int reference)
{
    const int choice = reference - i->scene->parameters;
    return choice >= 0 && choice < i->scene->choices ? i->flags.choice[choice] + 1 : *value_address(i, reference);
}

const double *instance_place(const Instance *i, int reference)
{
    return value_address(i, reference);
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
