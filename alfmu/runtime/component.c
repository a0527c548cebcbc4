#include "component.h"

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define HANDLE 0x48414e44u /* "HAND" */
#define SAVED 0x53415645u  /* "SAVE" */

/* Those that a host cannot switch off but by naming others. */
#define ALWAYS (1u << WARNING | 1u << DISCARD | 1u << ERROR_ | 1u << FATAL)

const char *const category_names[CATEGORIES] = {
    "logAll", "logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal"};

static int phase(const Component *c)
{
    return c->instance->flags.phase;
}

/* Life ------------------------------------------------------------------------------------------------------------- */

Component *component_new(
    const char *name, const char *guid, const char *resources, size_t host, char *why, size_t why_size)
{
    Component *c;
    snprintf(why, why_size, "%s",
        !name || !*name ? "it needs a name"
            : !guid     ? "it needs the GUID, or instantiation token, of its description"
                        : "there is not enough memory");
    if (!name || !*name || !guid)
        return NULL;
    c = calloc(1, sizeof *c);
    if (!c)
        return NULL;
    c->scene = scene_of_fmu(resources, why, why_size);
    if (!c->scene || strcmp(guid, c->scene->guid) != 0) {
        if (c->scene)
            snprintf(why, why_size,
                "its description has another GUID, or instantiation token; scene and description must be of one FMU");
        scene_free(c->scene);
        free(c);
        return NULL;
    }
    c->magic = HANDLE;
    c->logged = ALWAYS;
    c->name = malloc(strlen(name) + 1);
    c->host = calloc(1, host);
    c->instance = instance_new(c->scene);
    if (!c->name || !c->host || !c->instance) {
        component_free(c);
        return NULL;
    }
    strcpy(c->name, name);
    return c;
}

void component_free(Component *c)
{
    if (!component_good(c))
        return;
    if (c->instance && phase(c) == LOOKING) {
        component_refuse(c, ERROR_, "FreeInstance", "not while a step is made");
        return;
    }
    c->magic = 0;
    instance_free(c->instance);
    scene_free(c->scene);
    free(c->before);
    free(c->after);
    free(c->host);
    free(c->name);
    free(c);
}

int component_good(const Component *c)
{
    return c && c->magic == HANDLE;
}

void component_say(Component *c, Category category, const char *text)
{
    char safe[1024];
    if (!c->log || !(c->logged & (1u << category)))
        return;
    snprintf(safe, sizeof safe, "%s", text);
    for (char *at = safe; (at = strchr(at, '%')); at++)
        *at = '?'; /* A host may take it for a format. */
    c->log(c->host, c->name, category, safe);
}

Status component_refuse(Component *c, Category category, const char *call, const char *why)
{
    char text[256];
    snprintf(text, sizeof text, "%s: %s: %s", c->instance->scene->name, call, why);
    component_say(c, category, text);
    return category == DISCARD ? DISCARDED : WRONG;
}

/* What the instance said when it refused something. */
static Status refused(Component *c, Status status)
{
    component_say(c, status == DISCARDED ? DISCARD : status == WARNED ? WARNING : ERROR_, c->instance->text);
    return status;
}

/* FINE, and what the instance warns of. */
static Status told(Component *c)
{
    if (c->instance->warns) {
        c->instance->warns = 0;
        component_say(c, WARNING, c->instance->warning);
    }
    return FINE;
}

/* A step of the instance, and what it warns of. */
static Outcome stepped(Component *c, double point, double step)
{
    Instance *i = c->instance;
    const Outcome outcome = instance_step(i, point, step);
    told(c);
    return outcome;
}

/* Whether the instance begins; what it says of the start, it says as a warning. */
static int begun(Component *c)
{
    if (instance_initialize(c->instance) != DONE)
        return 0;
    if (*c->instance->text)
        component_say(c, WARNING, c->instance->text);
    return 1;
}

int component_in(Component *c, int phases, const char *call)
{
    if (!component_good(c))
        return 0;
    if (phase(c) & phases)
        return 1;
    component_refuse(c, ERROR_, call,
        phase(c) == INSTANTIATED       ? "not before initialisation has begun"
            : phase(c) == INITIALIZING ? "not during initialisation"
            : phase(c) == STEPPING     ? "not after initialisation"
            : phase(c) == LOOKING      ? "not while a step is made"
                                       : "not after the run has ended");
    return 0;
}

/* Those of the categories that are known are logged from now on, where all are. */
Status component_logging(Component *c, int on, size_t count, const char *const categories[], const char *call)
{
    unsigned logged = 0;
    if (!component_in(c, ANY | LOOKING, call))
        return WRONG;
    for (size_t k = 0; k < count; k++) {
        int known = 0;
        for (int each = 0; categories && categories[k] && each < CATEGORIES; each++)
            if (!strcmp(categories[k], category_names[each])) {
                logged |= each == ALL ? ~0u : 1u << each;
                known = 1;
            }
        if (!known)
            return component_refuse(c, ERROR_, call, "there is no such category");
    }
    c->logged = !on ? ALWAYS : count ? logged : ~0u;
    return FINE;
}

Status component_begin(Component *c, double start, const double *stop, double tolerance, const char *call)
{
    if (!component_in(c, INSTANTIATED, call))
        return WRONG;
    if (!isfinite(start))
        return component_refuse(c, ERROR_, call, "the start time must be a finite number");
    if (instance_begin(c->instance, start, stop ? *stop : INFINITY) != DONE)
        return refused(c, WRONG);
    if (tolerance != 0.0 && instance_tolerate(c->instance, tolerance) != DONE)
        return refused(c, WARNED);
    return FINE;
}

Status component_enter(Component *c, const char *call)
{
    if (!component_in(c, INSTANTIATED, call))
        return WRONG;
    c->instance->flags.phase = INITIALIZING;
    return FINE;
}

Status component_initialized(Component *c, const char *call)
{
    Instance *i;
    if (!component_in(c, INITIALIZING, call))
        return WRONG;
    i = c->instance;
    if ((!i->flags.initialized && !begun(c)) || instance_read(i) != DONE)
        return refused(c, WRONG);
    i->flags.phase = STEPPING;
    return told(c);
}

Status component_terminated(Component *c, const char *call)
{
    if (!component_in(c, STEPPING, call))
        return WRONG;
    c->instance->flags.phase = TERMINATED;
    return FINE;
}

Status component_reset(Component *c, const char *call)
{
    if (!component_in(c, ANY, call))
        return WRONG;
    instance_reset(c->instance);
    return FINE;
}

/* Values ----------------------------------------------------------------------------------------------------------- */

static int is_time(const Component *c, unsigned reference)
{
    return c->has_time && reference == (unsigned)variable_count(c->instance->scene);
}

/* Whether a variable has values of a form. */
static int has_form(const Variable *v, Form form)
{
    static const unsigned kept[FORMS] = {
        1u << REAL, 1u << INTEGER, 1u << INTEGER | 1u << STRING, 1u << STRING, 1u << BOOLEAN, 1u << BOOLEAN};
    return (kept[form] >> (v->kind == CHOICE ? STRING : v->type)) & 1u;
}

/* Whether arrays can be looked at, and hold references of variables that have values of a form. */
static int addressed(Component *c, const unsigned *references, size_t count, const void *values, size_t value_count,
    Form form, const char *call)
{
    const Scene *s = c->instance->scene;
    const char *why = count != value_count ? "every variable is a scalar: as many values as references"
        : count && (!references || !values) ? "there is no array"
                                            : NULL;
    for (size_t k = 0; !why && k < count; k++)
        if (!(form == FLOATS && is_time(c, references[k]))
            && (references[k] >= (unsigned)variable_count(s) || !has_form(s->variables + references[k], form)))
            why = "no variable of this type has this value reference";
    if (why)
        component_refuse(c, ERROR_, call, why);
    return !why;
}

/* The same, where all are of a kind. */
static int addressed_kind(Component *c, const unsigned *references, size_t count, const void *values,
    size_t value_count, Kind kind, const char *call)
{
    if (!addressed(c, references, count, values, value_count, FLOATS, call))
        return 0;
    for (size_t k = 0; k < count; k++)
        if (is_time(c, references[k]) || c->instance->scene->variables[references[k]].kind != kind) {
            component_refuse(c, ERROR_, call, kind == INPUT ? "inputs alone have such" : "outputs alone have such");
            return 0;
        }
    return 1;
}

static void put(void *values, size_t k, Form form, double value)
{
    const int whole = fabs(value) <= 2147483647.0 ? (int)value : 0;
    switch (form) {
    case FLOATS:
        ((double *)values)[k] = value;
        break;
    case LONGS:
        ((int64_t *)values)[k] = whole;
        break;
    case FLAGS:
        ((int *)values)[k] = value != 0.0;
        break;
    case TRUTHS:
        ((bool *)values)[k] = value != 0.0;
        break;
    default:
        ((int *)values)[k] = whole;
    }
}

static double taken(const void *values, size_t k, Form form)
{
    switch (form) {
    case FLOATS:
        return ((const double *)values)[k];
    case LONGS:
        return (double)((const int64_t *)values)[k];
    case FLAGS:
        return ((const int *)values)[k] != 0;
    case TRUTHS: /* A byte of a host may be neither. */
        return ((const unsigned char *)values)[k * sizeof(bool)] != 0;
    default:
        return ((const int *)values)[k];
    }
}

Status component_get(Component *c, const unsigned *references, size_t count, void *values, size_t value_count,
    Form form, const char *call)
{
    Instance *i;
    int outputs = 0, finite = 1;
    /* FMI 3 gives start values as soon as there is an instance, FMI 2 when initialisation has begun. */
    const int phases = component_good(c) && c->has_time ? KNOWN | INSTANTIATED : KNOWN;
    if (!component_in(c, phases, call) || !addressed(c, references, count, values, value_count, form, call))
        return WRONG;
    i = c->instance;
    for (size_t k = 0; k < count; k++)
        outputs |= !is_time(c, references[k]) && i->scene->variables[references[k]].kind == OUTPUT;
    if (outputs && !i->flags.initialized) {
        if (phase(c) != INITIALIZING)
            return component_refuse(c, ERROR_, call, "outputs are known after initialising");
        if (!begun(c))
            return refused(c, WRONG);
    }
    if (outputs)
        instance_read(i);
    for (size_t k = 0; k < count; k++) {
        const double value = is_time(c, references[k]) ? *instance_time(i) : instance_get(i, (int)references[k]);
        put(values, k, form, value);
        finite &= isfinite(value) != 0;
    }
    return finite ? FINE : refused(c, DISCARDED);
}

/* Values that are refused leave those before them in force; the others are taken. */
Status component_set(Component *c, const unsigned *references, size_t count, const void *values, size_t value_count,
    Form form, const char *call)
{
    Status status = FINE;
    if (!component_in(c, BORN, call) || !addressed(c, references, count, values, value_count, form, call))
        return WRONG;
    for (size_t k = 0; k < count; k++) {
        const Kind kind = is_time(c, references[k]) ? OUTPUT : c->instance->scene->variables[references[k]].kind;
        if (kind == OUTPUT)
            return component_refuse(c, ERROR_, call, "an output cannot be set");
        if ((kind == PARAMETER || kind == CHOICE) && phase(c) == STEPPING)
            return component_refuse(c, ERROR_, call, "a parameter is fixed once the run has begun");
    }
    for (size_t k = 0; k < count; k++)
        if (instance_set(c->instance, (int)references[k], taken(values, k, form)) != DONE)
            status = refused(c, DISCARDED);
    return status;
}

/* Derivatives ------------------------------------------------------------------------------------------------------ */

Status component_slopes(Component *c, const unsigned *references, size_t count, const int *orders,
    const double *values, const char *call)
{
    Status status = FINE;
    if (!component_in(c, BORN, call) || !addressed_kind(c, references, count, values, count, INPUT, call))
        return WRONG;
    for (size_t k = 0; k < count; k++)
        if (!orders || orders[k] != 1)
            return component_refuse(c, ERROR_, call, "there are first derivatives of inputs alone");
    for (size_t k = 0; k < count; k++)
        if (instance_set_slope(c->instance, (int)references[k], values[k]) != DONE)
            status = refused(c, DISCARDED);
    return status;
}

Status component_output_derivatives(Component *c, const unsigned *references, size_t count, const int *orders,
    double *values, size_t value_count, const char *call)
{
    const Scene *s;
    if (!component_in(c, RUN, call) || !addressed_kind(c, references, count, values, value_count, OUTPUT, call))
        return WRONG;
    s = c->instance->scene;
    for (size_t k = 0; k < count; k++)
        if (!orders || orders[k] < 1 || orders[k] > 2)
            return component_refuse(c, ERROR_, call, "outputs have derivatives of orders 1 and 2");
        else if ((int)references[k] >= outputs_from(s) + s->outputs)
            return component_refuse(c, ERROR_, call, "derivatives over a step are discrete, and have no rate");
    if (count && instance_output_derivatives(c->instance, references, orders, count, values) != DONE)
        return refused(c, DISCARDED);
    return FINE;
}

/* Whether outputs can be differentiated by these variables now. */
static int addressed_knowns(
    Component *c, const unsigned *references, size_t count, const void *values, size_t value_count, const char *call)
{
    const Scene *s = c->instance->scene;
    const char *why = NULL;
    if (!addressed(c, references, count, values, value_count, FLOATS, call))
        return 0;
    for (size_t k = 0; k < count && !why; k++)
        if (is_time(c, references[k]) || !has_derivatives(s, (int)references[k]))
            why = "there are derivatives by inputs, parameters and start values alone";
        else if (s->variables[references[k]].kind == PARAMETER && phase(c) != INITIALIZING)
            why = "parameters and start values are fixed once the run has begun; ask for derivatives by them before";
    if (why)
        component_refuse(c, ERROR_, call, why);
    return !why;
}

/* Along a direction of what is known, or back from one of what is not. */
Status component_derivative(Component *c, const unsigned *unknowns, size_t unknown_count, const unsigned *knowns,
    size_t known_count, const double *seed, size_t seed_count, double *found, size_t found_count, int back, const char *call)
{
    const size_t *of_unknowns = back ? &seed_count : &found_count, *of_knowns = back ? &found_count : &seed_count;
    int inputs = 1;
    Instance *i;
    Outcome outcome;
    if (!component_in(c, KNOWN, call)
        || !addressed_kind(c, unknowns, unknown_count, back ? seed : found, *of_unknowns, OUTPUT, call)
        || !addressed_knowns(c, knowns, known_count, back ? found : seed, *of_knowns, call))
        return WRONG;
    i = c->instance;
    if (!i->flags.initialized && (phase(c) != INITIALIZING || !begun(c)))
        return component_refuse(c, ERROR_, call, "outputs are known after initialising");
    for (size_t k = 0; k < known_count; k++)
        inputs &= i->scene->variables[knowns[k]].kind == INPUT && !moves_start(i);
    outcome = instance_read(i);
    if (outcome == DONE && inputs && !back) /* What the scene has for them, which is evaluated at once. */
        outcome = instance_derivative(i, unknowns, unknown_count, knowns, known_count, seed, found);
    else if (outcome == DONE)
        outcome = instance_sweep(i, unknowns, unknown_count, knowns, known_count, seed, back, found);
    return outcome == DONE ? FINE : refused(c, DISCARDED);
}

/* Steps ------------------------------------------------------------------------------------------------------------ */

static State *saved(Component *c, State *state);

/* A step of a length from the state before a step that the host looks into, where it returns early: as if it had asked for
   that one. Where it cannot be made, the state here stays. */
static void returned(Component *c, double point, double step, long made)
{
    Instance *i = c->instance;
    if (made < 2) /* The only step so far is that one. */
        return;
    c->after = saved(c, c->after);
    if (!c->after)
        return;
    state_restore(i, c->before->bytes, c->before->size);
    if (instance_step(i, point, step) != DONE)
        state_restore(i, c->after->bytes, c->after->size);
    i->warns = 0; /* It has been said. */
}

/* A communication step into which the host looks. It is made as any other, and then again by internal ones, after each of
   which the host may look; at last the state is that of the first time, so that looks change nothing. The host may end the
   step at one of them; where the step fails, it then has what was reached before, and otherwise the whole step is taken
   back. */
static Status watched(Component *c, double point, double step, int *early)
{
    const int may_return = *early;
    Instance *i = c->instance;
    const double count = fmax(1.0, ceil(step / i->values[i->scene->step_size] * (1 - 1e-12))), length = step / count;
    double until = INFINITY;
    Outcome whole = instance_can_step(i, point, step);
    *early = 0;
    if (whole != DONE)
        return refused(c, whole == ENDED ? WRONG : DISCARDED);
    c->before = saved(c, c->before);
    if (!c->before)
        return component_refuse(c, ERROR_, "DoStep", "there is not enough memory");
    whole = stepped(c, point, step);
    if (whole == DONE && count > 1.0) {
        c->after = saved(c, c->after);
        if (!c->after)
            return component_refuse(c, ERROR_, "DoStep", "there is not enough memory");
        state_restore(i, c->before->bytes, c->before->size);
    }
    for (double k = 1.0; k <= count; k += 1.0) {
        Outcome outcome = DONE;
        if (whole != DONE || k < count) {
            i->within = k > 1.0;
            outcome = instance_step(i, k > 1.0 ? *instance_time(i) : point, length);
            i->within = 0;
            if (whole == DONE)
                i->warns = 0; /* It has been said. */
            else
                told(c);
        }
        if (outcome != DONE && whole == DONE)
            k = count; /* It can be made, in one. */
        else if (outcome != DONE && may_return && k > 1.0) {
            *early = 1; /* The next step says what is wrong. */
            returned(c, point, (k - 1.0) * length, (long)k - 1);
            return FINE;
        } else if (outcome != DONE) {
            const Status status = refused(c, outcome == ENDED ? WRONG : DISCARDED);
            state_restore(i, c->before->bytes, c->before->size);
            return status;
        }
        if (k == count && whole == DONE && count > 1.0)
            state_restore(i, c->after->bytes, c->after->size);
        else if (k == count)
            *instance_time(i) = point + step;
        *early = may_return && k < count;
        i->flags.phase = LOOKING;
        c->look(c->host, *instance_time(i), *early, &until);
        i->flags.phase = STEPPING;
        if (*early && *instance_time(i) >= until) {
            returned(c, point, k * length, (long)k);
            return FINE;
        }
    }
    return FINE;
}

/* `early` says whether the host takes an early return, and then whether there was one. */
Status component_step(Component *c, double point, double step, int *early, const char *call)
{
    Outcome outcome;
    if (!component_in(c, STEPPING, call))
        return WRONG;
    if (early && c->look)
        return watched(c, point, step, early);
    if (early)
        *early = 0;
    outcome = stepped(c, point, step);
    /* A host makes other steps where one is discarded, and none would lead on. */
    return outcome == DONE ? FINE : refused(c, outcome == ENDED ? WRONG : DISCARDED);
}

/* State ------------------------------------------------------------------------------------------------------------ */

static State *new_state(const Component *c)
{
    const size_t size = state_size(c->instance);
    State *state = calloc(1, sizeof *state + size);
    if (state) {
        state->magic = SAVED;
        state->size = size;
    }
    return state;
}

/* The state of a component, in place of one that is given; NULL where there is no memory. */
static State *saved(Component *c, State *state)
{
    if (!state)
        state = new_state(c);
    if (state)
        state_save(c->instance, state->bytes);
    return state;
}

static int state_good(const Component *c, const State *state)
{
    return state && state->magic == SAVED && state->size == state_size(c->instance);
}

static int state_known(Component *c, const State *state, const char *call)
{
    if (!component_in(c, ANY, call))
        return 0;
    if (state_good(c, state))
        return 1;
    component_refuse(c, ERROR_, call, "the state is not one of this FMU");
    return 0;
}

Status component_save(Component *c, void **state, const char *call)
{
    if (!component_in(c, ANY, call) || !state || (*state && !state_known(c, *state, call)))
        return WRONG;
    *state = saved(c, *state);
    return *state ? FINE : component_refuse(c, ERROR_, call, "there is not enough memory");
}

Status component_restore(Component *c, void *state, const char *call)
{
    const State *s = state;
    if (!state_known(c, s, call))
        return WRONG;
    return state_restore(c->instance, s->bytes, s->size) == DONE ? FINE : refused(c, WRONG);
}

Status component_forget(Component *c, void **state, const char *call)
{
    if (!component_in(c, ANY, call) || !state || (*state && !state_known(c, *state, call)))
        return WRONG;
    free(*state);
    *state = NULL;
    return FINE;
}

Status component_state_size(Component *c, void *state, size_t *size, const char *call)
{
    const State *s = state;
    if (!state_known(c, s, call) || !size)
        return WRONG;
    *size = s->size;
    return FINE;
}

Status component_write(Component *c, void *state, void *bytes, size_t size, const char *call)
{
    const State *s = state;
    if (!state_known(c, s, call))
        return WRONG;
    if (!bytes || size < s->size)
        return component_refuse(c, ERROR_, call, "there is no room for the state");
    memcpy(bytes, s->bytes, s->size);
    return FINE;
}

/* A copy of the bytes: what they say is looked at when they are restored. */
Status component_read(Component *c, const void *bytes, size_t size, void **state, const char *call)
{
    State *made;
    if (!component_in(c, ANY, call) || !bytes || !state)
        return WRONG;
    if (!state_whole(c->instance, bytes, size))
        return component_refuse(c, ERROR_, call,
            "the saved state is not one of this mechanism, or has changed since (check sum); save it again");
    made = new_state(c);
    if (!made)
        return component_refuse(c, ERROR_, call, "there is not enough memory");
    memcpy(made->bytes, bytes, size);
    *state = made;
    return FINE;
}
