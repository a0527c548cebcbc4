#include "component.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define HANDLE 0x48414e44u /* "HAND" */
#define SAVED 0x53415645u  /* "SAVE" */

/* Those that a host cannot switch off but by naming others. */
#define ALWAYS (1u << WARNING | 1u << DISCARD | 1u << ERROR_ | 1u << FATAL)

const char *const category_names[CATEGORIES] = {
    "logAll", "logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal"};

Component *component_new(const char *name, const char *guid, const char *resources, char *why, size_t why_size)
{
    Component *c;
    snprintf(why, why_size, "it needs a name");
    if (!name || !*name)
        return NULL;
    c = calloc(1, sizeof *c);
    snprintf(why, why_size, "there is no memory for it");
    if (!c)
        return NULL;
    c->scene = scene_of_fmu(resources, why, why_size);
    if (!c->scene || !guid || strcmp(guid, c->scene->guid) != 0) {
        if (c->scene)
            snprintf(why, why_size, "it is %.40s, and %.100s is asked for", c->scene->guid, guid ? guid : "nothing");
        scene_free(c->scene);
        free(c);
        return NULL;
    }
    c->magic = HANDLE;
    c->phase = INSTANTIATED;
    c->logged = ALWAYS;
    c->name = malloc(strlen(name) + 1);
    c->instance = instance_new(c->scene);
    if (!c->name || !c->instance) {
        component_free(c);
        return NULL;
    }
    strcpy(c->name, name);
    return c;
}

void component_free(Component *c)
{
    c->magic = 0;
    instance_free(c->instance);
    scene_free(c->scene);
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

void component_refuse(Component *c, Category category, const char *call, const char *why)
{
    char text[256];
    snprintf(text, sizeof text, "%s: %s: %s", c->instance->scene->name, call, why);
    component_say(c, category, text);
}

int component_in(Component *c, int phases, const char *call)
{
    if (!component_good(c))
        return 0;
    if (c->phase & phases)
        return 1;
    component_refuse(c, ERROR_, call,
        c->phase == INSTANTIATED       ? "not before initialisation has begun"
            : c->phase == INITIALIZING ? "not during initialisation"
            : c->phase == STEPPING     ? "not after initialisation"
                                       : "not after the run has ended");
    return 0;
}

/* Whether all categories were known; those that were are logged from now on. */
int component_logging(Component *c, int on, size_t count, const char *const categories[])
{
    unsigned logged = 0;
    for (size_t k = 0; k < count; k++) {
        int known = 0;
        for (int each = 0; categories && categories[k] && each < CATEGORIES; each++)
            if (!strcmp(categories[k], category_names[each])) {
                logged |= each == ALL ? ~0u : 1u << each;
                known = 1;
            }
        if (!known) {
            component_refuse(c, ERROR_, "log categories", "there is no such category");
            return 0;
        }
    }
    c->logged = !on ? ALWAYS : count ? logged : ~0u;
    return 1;
}

/* Whether there is a variable of this type. */
static int known_variable(Component *c, unsigned reference, Type type, const char *call)
{
    const Scene *s = c->instance->scene;
    if (reference < (unsigned)variable_count(s) && s->variables[reference].type == type)
        return 1;
    component_refuse(c, ERROR_, call, "no variable of this type has this value reference");
    return 0;
}

static int settable(Component *c, unsigned reference, const char *call)
{
    const Kind kind = c->instance->scene->variables[reference].kind;
    if (kind == OUTPUT)
        component_refuse(c, ERROR_, call, "an output cannot be set");
    else if ((kind == PARAMETER || kind == CHOICE) && c->phase == STEPPING)
        component_refuse(c, ERROR_, call, "a parameter is fixed once the run has begun");
    else
        return 1;
    return 0;
}

/* Makes sure that outputs are known, and says so where not all are. */
static Status known_outputs(Component *c)
{
    Instance *i = c->instance;
    if (!i->flags.initialized && (c->phase != INITIALIZING || instance_initialize(i) != DONE)) {
        component_say(c, ERROR_, c->phase == INITIALIZING ? i->text : "outputs are known after initialising");
        return WRONG;
    }
    if (instance_read(i) == DONE)
        return FINE;
    component_say(c, WARNING, i->text);
    return WARNED;
}

static Status refused(Component *c, Status status)
{
    component_say(c, status == DISCARDED ? DISCARD : ERROR_, c->instance->text);
    return status;
}

Status component_begin(Component *c, double start, double tolerance, const char *call)
{
    if (!component_in(c, INSTANTIATED, call))
        return WRONG;
    if (!isfinite(start)) {
        component_refuse(c, ERROR_, call, "the start time must be a finite number");
        return WRONG;
    }
    *instance_time(c->instance) = start;
    if (tolerance != 0.0)
        return component_set(c, FINE, instance_tolerate(c->instance, tolerance));
    return FINE;
}

Status component_initialized(Component *c, const char *call)
{
    Instance *i;
    if (!component_in(c, INITIALIZING, call))
        return WRONG;
    i = c->instance;
    if (instance_refusals(i) != DONE || (!i->flags.initialized && instance_initialize(i) != DONE))
        return refused(c, WRONG);
    i->flags.running = 1;
    c->phase = STEPPING;
    return FINE;
}

Status component_terminated(Component *c, const char *call)
{
    if (!component_in(c, STEPPING, call))
        return WRONG;
    c->phase = TERMINATED;
    return FINE;
}

Status component_reset(Component *c, const char *call)
{
    if (!component_in(c, ANY, call))
        return WRONG;
    instance_reset(c->instance);
    c->phase = INSTANTIATED;
    return FINE;
}

static int arrays(Component *c, const unsigned *references, size_t count, const void *values, const char *call)
{
    if (!count || (references && values))
        return 1;
    component_refuse(c, ERROR_, call, "there is no array");
    return 0;
}

Status component_readable(
    Component *c, const unsigned *references, size_t count, const void *values, Type type, const char *call)
{
    int outputs = 0;
    if (!component_in(c, KNOWN, call) || !arrays(c, references, count, values, call))
        return WRONG;
    for (size_t k = 0; k < count; k++) {
        if (!known_variable(c, references[k], type, call))
            return WRONG;
        outputs |= c->instance->scene->variables[references[k]].kind == OUTPUT;
    }
    return outputs ? known_outputs(c) : FINE;
}

Status component_writable(
    Component *c, const unsigned *references, size_t count, const void *values, Type type, const char *call)
{
    if (!component_in(c, BORN, call) || !arrays(c, references, count, values, call))
        return WRONG;
    for (size_t k = 0; k < count; k++)
        if (!known_variable(c, references[k], type, call) || !settable(c, references[k], call))
            return WRONG;
    return FINE;
}

Status component_set(Component *c, Status status, Outcome outcome)
{
    return outcome == DONE ? status : refused(c, DISCARDED);
}

Status component_derivative(Component *c, const unsigned *unknowns, size_t unknown_count, const unsigned *knowns,
    size_t known_count, const double *directions, double *changes, const char *call)
{
    Status status = component_readable(c, unknowns, unknown_count, changes, REAL, call);
    const Variable *variables;
    if (status != FINE)
        return status;
    if (!arrays(c, knowns, known_count, directions, call))
        return WRONG;
    variables = c->instance->scene->variables;
    for (size_t k = 0; k < known_count; k++)
        if (!known_variable(c, knowns[k], REAL, call) || variables[knowns[k]].kind != INPUT) {
            component_refuse(c, ERROR_, call, "derivatives are by inputs alone");
            return WRONG;
        }
    for (size_t k = 0; k < unknown_count; k++)
        if (variables[unknowns[k]].kind != OUTPUT) {
            component_refuse(c, ERROR_, call, "derivatives are of outputs alone");
            return WRONG;
        }
    return component_set(c, FINE,
        instance_derivative(c->instance, unknowns, unknown_count, knowns, known_count, directions, changes));
}

Status component_step(Component *c, double point, double step)
{
    if (instance_refusals(c->instance) != DONE || instance_step(c->instance, point, step) != DONE)
        return refused(c, DISCARDED);
    return FINE;
}

static State *state_new(const Component *c)
{
    const size_t size = state_size(c->instance);
    State *state = calloc(1, sizeof *state + size);
    if (state) {
        state->magic = SAVED;
        state->size = size;
    }
    return state;
}

static int state_good(const Component *c, const State *state)
{
    return state && state->magic == SAVED && state->size == state_size(c->instance);
}

/* The state of an instance, in place of one that is given; NULL where that is none. */
State *state_of(Component *c, State *state, const char *call)
{
    if (!state)
        state = state_new(c);
    if (!state_good(c, state)) {
        component_refuse(c, ERROR_, call, "there is no memory, or the state is not one of this FMU");
        return NULL;
    }
    state->phase = c->phase;
    state_save(c->instance, state->bytes);
    return state;
}

int state_known(Component *c, const State *state, const char *call)
{
    if (!component_in(c, ANY, call))
        return 0;
    if (state_good(c, state))
        return 1;
    component_refuse(c, ERROR_, call, "the state is not one of this FMU");
    return 0;
}

int state_apply(Component *c, const State *state)
{
    if (state_restore(c->instance, state->bytes, state->size) != DONE) {
        component_say(c, ERROR_, c->instance->text);
        return 0;
    }
    c->phase = state->phase;
    return 1;
}

size_t serialized_size(const State *state)
{
    return sizeof *state + state->size;
}

void serialize(const State *state, unsigned char *bytes)
{
    memcpy(bytes, state, serialized_size(state));
}

State *deserialized(Component *c, const unsigned char *bytes, size_t size)
{
    State *state = state_new(c);
    Phase phase;
    if (!state)
        return NULL;
    if (size == serialized_size(state)) {
        memcpy(state, bytes, size);
        phase = state->phase;
        if (state_good(c, state)
            && (phase == INSTANTIATED || phase == INITIALIZING || phase == STEPPING || phase == TERMINATED))
            return state;
    }
    free(state);
    component_refuse(c, ERROR_, "deserialise", "the saved state is not one of this mechanism; save it again");
    return NULL;
}
