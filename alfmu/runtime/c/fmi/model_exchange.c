#include "model_exchange.h"

#include "component.h"
#include "exchange.h"
#include "instance.h"
#include "scene_sizes.h"

Component *exchange_instance(Component *c, char *why, size_t why_size)
{
    if (!c || scene_exchanged(c->scene)) {
        if (c)
            c->exchanges = 1;
        return c;
    }
    component_free(c);
    write_text(why, why_size, CO_SIMULATION);
    return NULL;
}

/* Return whether a call of Model Exchange is legal in these phases. */
static int exchanges_now(Component *c, int phases, const char *call)
{
    if (!component_in(c, phases, call))
        return 0;
    if (!c->exchanges)
        component_refuse(c, ERROR_, call, "the instance is for co-simulation");
    return c->exchanges;
}

/* Return whether a call is legal in these phases, and in these modes once the run has begun. */
static int is_in(Component *c, int phases, int modes, const char *call)
{
    if (!exchanges_now(c, phases, call))
        return 0;
    if (modes & 1 << c->instance->flags.mode || !(component_phase(c) & RUN))
        return 1;
    component_refuse(c, ERROR_, call,
        c->instance->flags.mode == AT_EVENT ? "not in event mode"
            : c->instance->flags.mode       ? "not in continuous-time mode"
                                            : "its state was saved in co-simulation");
    return 0;
}

#define EVENT_MODE (1 << AT_EVENT)
#define CONTINUOUS_MODE (1 << CONTINUOUS)
#define EITHER (EVENT_MODE | CONTINUOUS_MODE)

static Status answered(Component *c, Outcome outcome)
{
    if (outcome != DONE)
        return component_refused(c, STATUS_DISCARD);
    component_warn(c);
    return STATUS_OK;
}

Status exchange_initialized(Component *c, const char *call)
{
    const Status status = component_initialized(c, call);
    return status != STATUS_OK || !c->exchanges   ? status
        : exchange_begin(c->instance) == DONE ? STATUS_OK
                                                  : component_refused(c, STATUS_ERROR);
}

Status exchange_enter(Component *c, int mode, const char *call)
{
    if (!is_in(c, STEPPING, mode == CONTINUOUS ? EVENT_MODE : EITHER, call))
        return STATUS_ERROR;
    c->instance->flags.mode = mode;
    return STATUS_OK;
}

Status exchange_time(Component *c, double time, const char *call)
{
    if (!is_in(c, STEPPING, EITHER, call))
        return STATUS_ERROR;
    if (!isfinite(time))
        return component_refuse(c, ERROR_, call, "the time must be a finite number");
    exchange_set_time(c->instance, time);
    return STATUS_OK;
}

static int length_of(const Component *c, Exchanged which)
{
    return which == INDICATORS ? c->scene->frictions : scene_exchanged(c->scene);
}

static int is_array(Component *c, Exchanged which, const double *values, size_t count, const char *call)
{
    if (count == (size_t)length_of(c, which) && (values || !count))
        return 1;
    component_refuse(c, ERROR_, call, "the length of the array is not the number of states or event indicators");
    return 0;
}

Status exchange_set(Component *c, const double *states, size_t count, const char *call)
{
    if (!is_in(c, STEPPING, CONTINUOUS_MODE, call) || !is_array(c, STATES, states, count, call))
        return STATUS_ERROR;
    for (size_t k = 0; k < count; k++)
        if (!isfinite(states[k]))
            return component_refuse(c, DISCARD, call, "a state is not finite");
    exchange_set_states(c->instance, states);
    return STATUS_OK;
}

/* Nominal values are known at once; states, rates and indicators as soon as initialisation has begun. */
Status exchange_get(Component *c, Exchanged which, double *values, size_t count, const char *call)
{
    const int phases = RUN | INITIALIZING | (which == NOMINALS ? INSTANTIATED : 0);
    Instance *i;
    if (!is_in(c, phases, EITHER, call) || !is_array(c, which, values, count, call))
        return STATUS_ERROR;
    i = c->instance;
    if (which == NOMINALS)
        exchange_nominals(i, values);
    else {
        const int states = scene_exchanged(c->scene);
        if (!i->flags.initialized && !component_begun(c))
            return component_refused(c, STATUS_ERROR);
        if (which != STATES || !i->flags.mode) {
            const Status status = answered(c, which == INDICATORS ? exchange_indicate(i) : exchange_read(i));
            if (status != STATUS_OK)
                return status;
        }
        memcpy(values, i->exchange + which * states, count * sizeof *values);
    }
    return STATUS_OK;
}

Status exchange_count(Component *c, Exchanged which, size_t *count, const char *call)
{
    if (!exchanges_now(c, ANY, call) || !count)
        return STATUS_ERROR;
    *count = (size_t)length_of(c, which);
    return STATUS_OK;
}

Status exchange_accepted(Component *c, int *enter, const char *call)
{
    return is_in(c, STEPPING, CONTINUOUS_MODE, call) ? answered(c, exchange_accept(c->instance, enter)) : STATUS_ERROR;
}

Status exchange_updated(Component *c, Exchange_event *event, const char *call)
{
    Outcome outcome;
    if (!is_in(c, STEPPING, EVENT_MODE, call))
        return STATUS_ERROR;
    event->next = INFINITY;
    outcome = exchange_event(c->instance, &event->next);
    event->timed = event->next < INFINITY;
    if (outcome != DONE)
        return component_refused(c, STATUS_ERROR);
    return component_warn(c);
}
