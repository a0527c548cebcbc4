/* The functions of Model Exchange that FMI 2 and FMI 3 share. */

#pragma once

#include "component.h"
#include "text.h"

/* Vectors that the host requests; the first three are stored in this order. */
typedef enum { STATES, RATES, INDICATORS, NOMINALS } Exchanged;

/* Information for the host after an event. States always count as changed: some hosts restart their method only then,
   and would continue with the rates before the event. */
typedef struct {
    int timed; /* whether there is a next event at a known time */
    double next;
} Exchange_event;

#define CO_SIMULATION "it supports co-simulation only"

#ifndef WITHOUT_MODEL_EXCHANGE
/* Make a new component one of Model Exchange; NULL, and the reason in `why`, if its scene is for co-simulation only. */
Component *exchange_instance(Component *c, char *why, size_t why_size);

/* Complete initialisation, and enter event mode. */
Status exchange_initialized(Component *c, const char *call);
Status exchange_enter(Component *c, int mode, const char *call);
Status exchange_time(Component *c, double time, const char *call);
Status exchange_set(Component *c, const double *states, size_t count, const char *call);
Status exchange_get(Component *c, Exchanged which, double *values, size_t count, const char *call);
Status exchange_count(Component *c, Exchanged which, size_t *count, const char *call);
Status exchange_accepted(Component *c, int *enter, const char *call);
Status exchange_updated(Component *c, Exchange_event *event, const char *call);
#else
static inline Component *exchange_instance(Component *c, char *why, size_t why_size)
{
    if (c)
        write_text(why, why_size, CO_SIMULATION);
    component_free(c);
    return NULL;
}
static inline Status exchange_initialized(Component *c, const char *call) { return component_initialized(c, call); }
static inline Status exchange_none(Component *c, const char *call)
{
    return component_good(c) ? component_refuse(c, ERROR_, call, CO_SIMULATION) : STATUS_ERROR;
}
#define exchange_enter(c, mode, call) exchange_none(c, call)
#define exchange_time(c, time, call) exchange_none(c, ((void)(time), call))
#define exchange_set(c, states, count, call) exchange_none(c, ((void)(states), (void)(count), call))
#define exchange_get(c, which, values, count, call) exchange_none(c, ((void)(values), (void)(count), call))
#define exchange_count(c, which, count, call) exchange_none(c, ((void)(count), call))
#define exchange_accepted(c, enter, call) exchange_none(c, call)
#define exchange_updated(c, event, call) exchange_none(c, ((void)(event), call))
#endif
