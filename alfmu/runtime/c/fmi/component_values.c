#include "component_values.h"

#include <stdbool.h>

#include "component.h"
#include "exchange.h"
#include "instance.h"
#include "instant_derivatives.h"
#include "outputs.h"
#include "run.h"
#include "scene.h"
#include "scene_sizes.h"
#include "variables.h"

/* Return whether a variable is one of Model Exchange, which follow those of the scene. */
static int is_exchanged(const Component *c, unsigned reference)
{
    const Scene *s = c->instance->scene;
    const unsigned first = (unsigned)scene_variable_count(s);
    return reference >= first && reference - first < (unsigned)scene_exchange_variables(s);
}

/* Time is the last variable. */
static int is_time(const Component *c, unsigned reference)
{
    const Scene *s = c->instance->scene;
    return c->has_time && reference == (unsigned)(scene_variable_count(s) + scene_exchange_variables(s));
}

/* Return the kind of a variable of the scene; the others are outputs. */
static Kind kind_of(const Component *c, unsigned reference)
{
    const Scene *s = c->instance->scene;
    return reference < (unsigned)scene_variable_count(s) ? s->variables[reference].kind : OUTPUT;
}

/* Return whether a variable has values of this type. */
static int component_has_form(const Variable *v, Value_type form)
{
    static const unsigned kept[VALUE_TYPES] = {
        1u << REAL, 1u << INTEGER, 1u << INTEGER | 1u << STRING, 1u << STRING, 1u << BOOLEAN, 1u << BOOLEAN};
    return (kept[form] >> (v->kind == CHOICE ? STRING : v->type)) & 1u;
}

/* Return whether the arrays are complete and refer to variables of this type. */
static int check_references(Component *c, const unsigned *references, size_t count, const void *values,
    size_t value_count, Value_type form, const char *call)
{
    const Scene *s = c->instance->scene;
    const char *why = count != value_count ? "every variable is a scalar; give as many values as references"
        : count && (!references || !values) ? "an array is missing"
                                            : NULL;
    for (size_t k = 0; !why && k < count; k++)
        if (!(form == AS_DOUBLE && (is_time(c, references[k]) || is_exchanged(c, references[k])))
            && (references[k] >= (unsigned)scene_variable_count(s)
                || !component_has_form(s->variables + references[k], form)))
            why = "no variable of this type has this value reference";
    if (why)
        component_refuse(c, ERROR_, call, why);
    return !why;
}

/* Return the same for variables that must be of one kind. */
static int check_references_of(Component *c, const unsigned *references, size_t count, const void *values,
    size_t value_count, Kind kind, const char *call)
{
    if (!check_references(c, references, count, values, value_count, AS_DOUBLE, call))
        return 0;
    for (size_t k = 0; k < count; k++)
        if (is_time(c, references[k]) || kind_of(c, references[k]) != kind) {
            component_refuse(c, ERROR_, call,
                kind == INPUT ? "only derivatives of inputs can be set" : "only outputs have derivatives");
            return 0;
        }
    return 1;
}

static void put_value(void *values, size_t k, Value_type form, double value)
{
    const int whole = fabs(value) <= 2147483647.0 ? (int)value : 0;
    switch (form) {
    case AS_DOUBLE:
        ((double *)values)[k] = value;
        break;
    case AS_INT64:
        ((int64_t *)values)[k] = whole;
        break;
    case AS_INT_BOOLEAN:
        ((int *)values)[k] = value != 0.0;
        break;
    case AS_BOOL:
        ((bool *)values)[k] = value != 0.0;
        break;
    default:
        ((int *)values)[k] = whole;
    }
}

static double take_value(const void *values, size_t k, Value_type form)
{
    switch (form) {
    case AS_DOUBLE:
        return ((const double *)values)[k];
    case AS_INT64:
        return (double)((const int64_t *)values)[k];
    case AS_INT_BOOLEAN:
        return ((const int *)values)[k] != 0;
    case AS_BOOL: /* A byte of a host may be neither 0 nor 1. */
        return ((const unsigned char *)values)[k * sizeof(bool)] != 0;
    default:
        return ((const int *)values)[k];
    }
}

Status component_get(Component *c, const unsigned *references, size_t count, void *values, size_t value_count,
    Value_type form, const char *call)
{
    Instance *i;
    int outputs = 0, exchanged = 0, finite = 1;
    /* FMI 3 permits reading start values once there is an instance, FMI 2 once initialisation has begun. */
    const int phases = component_good(c) && c->has_time ? KNOWN | INSTANTIATED : KNOWN;
    if (!component_in(c, phases, call) || !check_references(c, references, count, values, value_count, form, call))
        return STATUS_ERROR;
    i = c->instance;
    for (size_t k = 0; k < count; k++) {
        exchanged |= is_exchanged(c, references[k]);
        outputs |= !is_time(c, references[k]) && kind_of(c, references[k]) == OUTPUT;
    }
    if (outputs && !i->flags.initialized) {
        if (component_phase(c) != INITIALIZING)
            return component_refuse(c, ERROR_, call, "outputs are known after initialising");
        if (!component_begun(c))
            return component_refused(c, STATUS_ERROR);
    }
    if (exchanged && exchange_indicate(i) != DONE)
        return component_refused(c, STATUS_DISCARD);
    if (outputs && !exchanged && exchange_or_read(i, 0) != DONE && i->flags.mode)
        return component_refused(c, STATUS_DISCARD);
    for (size_t k = 0; k < count; k++) {
        const double value = is_time(c, references[k]) ? *instance_time(i) : instance_get(i, (int)references[k]);
        put_value(values, k, form, value);
        finite &= isfinite(value) != 0;
    }
    return finite ? STATUS_OK : component_refused(c, STATUS_DISCARD);
}

/* Set variables. A refused value leaves the previous one in force; the other values are set. */
Status component_set(Component *c, const unsigned *references, size_t count, const void *values, size_t value_count,
    Value_type form, const char *call)
{
    Status status = STATUS_OK;
    if (!component_in(c, BORN, call) || !check_references(c, references, count, values, value_count, form, call))
        return STATUS_ERROR;
    for (size_t k = 0; k < count; k++) {
        const Kind kind = kind_of(c, references[k]);
        if (kind == OUTPUT)
            return component_refuse(c, ERROR_, call, "an output cannot be set");
        if ((kind == PARAMETER || kind == CHOICE) && component_phase(c) == STEPPING)
            return component_refuse(c, ERROR_, call, "a parameter is fixed once the run has begun");
    }
    for (size_t k = 0; k < count; k++)
        if (instance_set(c->instance, (int)references[k], take_value(values, k, form)) != DONE)
            status = component_refused(c, STATUS_DISCARD);
    return status;
}

Status component_slopes(Component *c, const unsigned *references, size_t count, const int *orders,
    const double *values, const char *call)
{
    Status status = STATUS_OK;
    if (!component_in(c, BORN, call) || !check_references_of(c, references, count, values, count, INPUT, call))
        return STATUS_ERROR;
    for (size_t k = 0; k < count; k++)
        if (!orders || orders[k] != 1)
            return component_refuse(c, ERROR_, call, "inputs have derivatives of order 1 only");
    if (c->exchanges)
        return component_refuse(c, ERROR_, call, "the instance is for Model Exchange");
    for (size_t k = 0; k < count; k++)
        if (instance_set_slope(c->instance, (int)references[k], values[k]) != DONE)
            status = component_refused(c, STATUS_DISCARD);
    return status;
}

Status component_output_derivatives(Component *c, const unsigned *references, size_t count, const int *orders,
    double *values, size_t value_count, const char *call)
{
    const Scene *s;
    if (!component_in(c, RUN, call) || !check_references_of(c, references, count, values, value_count, OUTPUT, call))
        return STATUS_ERROR;
    if (c->exchanges)
        return component_refuse(c, ERROR_, call, "the instance is for Model Exchange");
    s = c->instance->scene;
    for (size_t k = 0; k < count; k++)
        if (!orders || orders[k] < 1 || orders[k] > 2)
            return component_refuse(c, ERROR_, call, "outputs have derivatives of orders 1 and 2 only");
        else if ((int)references[k] >= scene_first_output(s) + s->outputs)
            return component_refuse(c, ERROR_, call, "derivatives over a step are discrete, and have no time "
                                                     "derivative");
    if (count && instance_output_derivatives(c->instance, references, orders, count, values) != DONE)
        return component_refused(c, STATUS_DISCARD);
    return STATUS_OK;
}

/* Return whether outputs can be differentiated with respect to these variables now. */
static int addressed_knowns(
    Component *c, const unsigned *references, size_t count, const void *values, size_t value_count, const char *call)
{
    const Scene *s = c->instance->scene;
    const char *why = NULL;
    if (!check_references(c, references, count, values, value_count, AS_DOUBLE, call))
        return 0;
    for (size_t k = 0; k < count && !why; k++)
        if (is_exchanged(c, references[k]) && references[k] < (unsigned)(scene_variable_count(s) + scene_exchanged(s)))
            why = c->instance->flags.mode ? NULL : "derivatives by states exist in Model Exchange only";
        else if (kind_of(c, references[k]) == OUTPUT || !variable_has_derivatives(s, (int)references[k]))
            why = "derivatives exist by inputs, states, parameters and start values only";
        else if (kind_of(c, references[k]) == PARAMETER && component_phase(c) != INITIALIZING)
            why = "parameters and start values are fixed once the run has begun; ask for derivatives by them before";
    if (why)
        component_refuse(c, ERROR_, call, why);
    return !why;
}

/* Differentiate along a direction of the knowns, or, if `back` is not NULL, backwards for weights of the unknowns. */
Status component_derivative(Component *c, const unsigned *unknowns, size_t unknown_count, const unsigned *knowns,
    size_t known_count, const double *seed, size_t seed_count, double *found, size_t found_count, Sweep *back,
    const char *call)
{
    const size_t *of_unknowns = back ? &seed_count : &found_count, *of_knowns = back ? &found_count : &seed_count;
    Instance *i;
    Outcome outcome;
    if (!component_in(c, KNOWN, call)
        || !check_references_of(c, unknowns, unknown_count, back ? seed : found, *of_unknowns, OUTPUT, call)
        || !addressed_knowns(c, knowns, known_count, back ? found : seed, *of_knowns, call))
        return STATUS_ERROR;
    i = c->instance;
    for (size_t k = 0; k < unknown_count; k++)
        if (is_exchanged(c, unknowns[k])
            && unknowns[k] >= (unsigned)(scene_variable_count(i->scene) + 2 * scene_exchanged(i->scene)))
            return component_refuse(c, ERROR_, call, "event indicators have no derivatives");
    if (!i->flags.initialized && (component_phase(c) != INITIALIZING || !component_begun(c)))
        return component_refuse(c, ERROR_, call, "outputs are known after initialising");
    outcome = exchange_or_read(i, 0);
    if (outcome == DONE)
        outcome = instance_sweep(i, unknowns, unknown_count, knowns, known_count, seed, back, found);
    return outcome == DONE ? STATUS_OK : component_refused(c, STATUS_DISCARD);
}
