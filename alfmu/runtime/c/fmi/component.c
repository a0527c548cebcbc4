/* Common part of FMI 2 and FMI 3: an instance behind a handle, its phase, its log. */

#include "component.h"

#include <stdio.h>
#include <stdlib.h>

#include "begin.h"
#include "driving_inputs.h"
#include "instance.h"
#include "lifetime.h"
#include "outputs.h"
#include "resources.h"
#include "run.h"
#include "scene.h"
#include "settings.h"
#include "state.h"

#define HANDLE 0x48414e44u /* "HAND" */
#define SAVED 0x53415645u  /* "SAVE" */

/* Categories that stay on unless a host names others. */
#define ALWAYS (1u << WARNING | 1u << DISCARD | 1u << ERROR_ | 1u << FATAL)

const char *const category_names[CATEGORIES] = {
    "logAll", "logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal"};

int component_phase(const Component *c)
{
    return c->instance->flags.phase;
}

Component *component_new(
    const char *name, const char *guid, const char *resources, size_t host, char *why, size_t why_size)
{
    Component *c;
    snprintf(why, why_size, "%s",
        !name || !*name ? "its instance name is empty; give one"
            : !guid     ? "the GUID, or instantiation token, is missing; give that of its description"
                        : NO_MEMORY);
    if (!name || !*name || !guid)
        return NULL;
    c = calloc(1, sizeof *c);
    if (!c)
        return NULL;
    c->scene = scene_of_fmu(resources, why, why_size);
    if (!c->scene || strcmp(guid, c->scene->guid) != 0) {
        if (c->scene)
            snprintf(why, why_size,
                "the GUID, or instantiation token, of its description differs from that of its scene; both must be of "
                "one FMU");
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
    if (c->instance && component_phase(c) == LOOKING) {
        component_refuse(c, ERROR_, "FreeInstance", "not during a step");
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
        *at = '?'; /* A host may take % for a format. */
    c->log(c->host, c->name, category, safe);
}

Status component_refuse(Component *c, Category category, const char *call, const char *why)
{
    char text[256];
    snprintf(text, sizeof text, "%s: %s: %s", c->instance->scene->name, call, why);
    component_say(c, category, text);
    return category == DISCARD ? STATUS_DISCARD : STATUS_ERROR;
}

/* Log the message of a refusal. */
Status component_refused(Component *c, Status status)
{
    component_say(c,
        status == STATUS_DISCARD       ? DISCARD
            : status == STATUS_WARNING ? WARNING
                                       : ERROR_,
        c->instance->text);
    return status;
}

/* Log the warning of the instance, if any, and return STATUS_OK. */
Status component_warn(Component *c)
{
    if (c->instance->warns) {
        c->instance->warns = 0;
        component_say(c, WARNING, c->instance->warning);
    }
    return STATUS_OK;
}

/* Make a step of the instance and log its warning. */
static Outcome log_step(Component *c, double point, double step)
{
    Instance *i = c->instance;
    const Outcome outcome = instance_step(i, point, step);
    component_warn(c);
    return outcome;
}

/* Initialise; messages of the start are logged as warnings. */
int component_begun(Component *c)
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
    if (component_phase(c) & phases)
        return 1;
    component_refuse(c, ERROR_, call,
        component_phase(c) == INSTANTIATED       ? "not before initialisation has begun"
            : component_phase(c) == INITIALIZING ? "not during initialisation"
            : component_phase(c) == STEPPING     ? "not after initialisation"
            : component_phase(c) == LOOKING      ? "not during a step"
                                       : "not after the run has ended");
    return 0;
}

/* Log the named categories from now on, if all are known. */
Status component_logging(Component *c, int on, size_t count, const char *const categories[], const char *call)
{
    unsigned logged = 0;
    if (!component_in(c, ANY | LOOKING, call))
        return STATUS_ERROR;
    for (size_t k = 0; k < count; k++) {
        int known = 0;
        for (int each = 0; categories && categories[k] && each < CATEGORIES; each++)
            if (!strcmp(categories[k], category_names[each])) {
                logged |= each == ALL ? ~0u : 1u << each;
                known = 1;
            }
        if (!known)
            return component_refuse(c, ERROR_, call, "a log category is unknown; use one of the description");
    }
    c->logged = !on ? ALWAYS : count ? logged : ~0u;
    return STATUS_OK;
}

Status component_begin(Component *c, double start, const double *stop, double tolerance, const char *call)
{
    if (!component_in(c, INSTANTIATED, call))
        return STATUS_ERROR;
    if (!isfinite(start))
        return component_refuse(c, ERROR_, call, "the start time must be a finite number");
    if (instance_begin(c->instance, start, stop ? *stop : INFINITY) != DONE)
        return component_refused(c, STATUS_ERROR);
    if (tolerance != 0.0 && instance_tolerate(c->instance, tolerance) != DONE)
        return component_refused(c, STATUS_WARNING);
    return STATUS_OK;
}

Status component_enter(Component *c, const char *call)
{
    if (!component_in(c, INSTANTIATED, call))
        return STATUS_ERROR;
    c->instance->flags.phase = INITIALIZING;
    return STATUS_OK;
}

Status component_initialized(Component *c, const char *call)
{
    Instance *i;
    if (!component_in(c, INITIALIZING, call))
        return STATUS_ERROR;
    i = c->instance;
    if ((!i->flags.initialized && !component_begun(c)) || instance_read(i) != DONE)
        return component_refused(c, STATUS_ERROR);
    i->flags.phase = STEPPING;
    return component_warn(c);
}

Status component_terminated(Component *c, const char *call)
{
    if (!component_in(c, STEPPING, call))
        return STATUS_ERROR;
    c->instance->flags.phase = TERMINATED;
    return STATUS_OK;
}

Status component_reset(Component *c, const char *call)
{
    if (!component_in(c, ANY, call))
        return STATUS_ERROR;
    instance_reset(c->instance);
    c->refusals = 0;
    return STATUS_OK;
}

static State *save_into(Component *c, State *state);

/* Return early: repeat the step from its start to the present time as a single step, as if the host had asked for it.
   If that fails, keep the present state. */
static void ask_early_return(Component *c, double point, double step, long made)
{
    Instance *i = c->instance;
    if (made < 2) /* The only step so far was a single one. */
        return;
    c->after = save_into(c, c->after);
    if (!c->after)
        return;
    state_restore(i, c->before->bytes, c->before->size);
    if (instance_step(i, point, step) != DONE)
        state_restore(i, c->after->bytes, c->after->size);
    i->warns = 0; /* This warning has been logged. */
}

/* Make a communication step with intermediate updates. It is made like any other, then repeated by internal steps,
   after each of which the host may look; at last the state of the first pass is restored, so that looks change nothing.
   The host may return early at a look. If the step fails, a host that may return early gets the state reached before;
   otherwise the whole step is taken back. */
static Status step_watched(Component *c, double point, double step, int *early)
{
    const int may_return = *early;
    Instance *i = c->instance;
    const double count = settings_internal_steps(i, step), length = step / count;
    double until = INFINITY;
    Outcome whole = instance_can_step(i, point, step);
    *early = 0;
    if (whole != DONE)
        return component_refused(c, whole == NO_STEP_ON ? STATUS_ERROR : STATUS_DISCARD);
    c->before = save_into(c, c->before);
    if (!c->before)
        return component_refuse(c, ERROR_, "DoStep", NO_MEMORY);
    whole = log_step(c, point, step);
    if (whole == DONE && count > 1.0) {
        c->after = save_into(c, c->after);
        if (!c->after)
            return component_refuse(c, ERROR_, "DoStep", NO_MEMORY);
        state_restore(i, c->before->bytes, c->before->size);
    }
    for (double k = 1.0; k <= count; k += 1.0) {
        Outcome outcome = DONE;
        if (whole != DONE || k < count) {
            i->within = k > 1.0;
            outcome = instance_step(i, k > 1.0 ? *instance_time(i) : point, length);
            i->within = 0;
            if (whole == DONE)
                i->warns = 0; /* This warning has been logged. */
            else
                component_warn(c);
        }
        if (outcome != DONE && whole == DONE)
            k = count; /* The step succeeds as a single one. */
        else if (outcome != DONE && may_return && k > 1.0) {
            *early = 1; /* The next step reports the error. */
            ask_early_return(c, point, (k - 1.0) * length, (long)k - 1);
            return STATUS_OK;
        } else if (outcome != DONE) {
            const Status status = component_refused(c, outcome == NO_STEP_ON ? STATUS_ERROR : STATUS_DISCARD);
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
            ask_early_return(c, point, k * length, (long)k);
            return STATUS_OK;
        }
    }
    return STATUS_OK;
}

/* `early`: whether the host accepts an early return; on return whether there was one. */
Status component_step(Component *c, double point, double step, int *early, const char *call)
{
    Outcome outcome;
    if (!component_in(c, STEPPING, call))
        return STATUS_ERROR;
    if (c->exchanges || c->instance->flags.mode)
        return component_refuse(c, ERROR_, call, "the instance, or its state, is for Model Exchange");
    if (early && c->look)
        return step_watched(c, point, step, early);
    if (early)
        *early = 0;
    outcome = log_step(c, point, step);
    c->refusals = outcome == DONE ? 0 : point == c->point && step == c->length ? c->refusals + 1 : 1;
    c->point = point;
    c->length = step;
    /* After a discarded step a host tries other steps; report an error if none can succeed. */
    return outcome == DONE ? STATUS_OK : component_refused(c, outcome == NO_STEP_ON ? STATUS_ERROR : STATUS_DISCARD);
}

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

/* Save the state of a component into `state`, or into a new one if it is NULL; return NULL if there is no memory. */
static State *save_into(Component *c, State *state)
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
        return STATUS_ERROR;
    *state = save_into(c, *state);
    return *state ? STATUS_OK : component_refuse(c, ERROR_, call, NO_MEMORY);
}

Status component_restore(Component *c, void *state, const char *call)
{
    const State *s = state;
    if (!state_known(c, s, call))
        return STATUS_ERROR;
    c->refusals = 0;
    return state_restore(c->instance, s->bytes, s->size) == DONE ? STATUS_OK : component_refused(c, STATUS_ERROR);
}

/* fmusim gives the state itself where its address belongs, which cannot begin as a state does: it would be odd. */
Status component_forget(Component *c, void **state, const char *call)
{
    void *itself = state, **at = c && state_good(c, itself) ? &itself : state;
    if (!component_in(c, ANY, call) || !at || (*at && !state_known(c, *at, call)))
        return STATUS_ERROR;
    free(*at);
    *at = NULL;
    return STATUS_OK;
}

Status component_state_size(Component *c, void *state, size_t *size, const char *call)
{
    const State *s = state;
    if (!state_known(c, s, call) || !size)
        return STATUS_ERROR;
    *size = s->size;
    return STATUS_OK;
}

Status component_write(Component *c, void *state, void *bytes, size_t size, const char *call)
{
    const State *s = state;
    if (!state_known(c, s, call))
        return STATUS_ERROR;
    if (!bytes || size < s->size)
        return component_refuse(c, ERROR_, call, "there is no room for the state");
    memcpy(bytes, s->bytes, s->size);
    return STATUS_OK;
}

/* Copy a state from bytes of the host; they are checked when the state is restored. */
Status component_read(Component *c, const void *bytes, size_t size, void **state, const char *call)
{
    State *made;
    if (!component_in(c, ANY, call) || !bytes || !state)
        return STATUS_ERROR;
    if (!state_whole(c->instance, bytes, size))
        return component_refuse(c, ERROR_, call,
            "the saved state is not one of this mechanism, or has changed since (check sum); save it again");
    made = new_state(c);
    if (!made)
        return component_refuse(c, ERROR_, call, NO_MEMORY);
    memcpy(made->bytes, bytes, size);
    *state = made;
    return STATUS_OK;
}
