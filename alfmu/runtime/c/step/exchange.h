/* Model Exchange: an importer integrates coordinates, their rates and the states of first-order equations. */

#pragma once

#include "instance.h"
#include "outputs.h"
#include "scene.h"

/* Times [s] stored after the variables of Model Exchange: the present laws hold between FROM and UNTIL, the laws after
   the next event from BEHIND on. */
enum { FROM, UNTIL, BEHIND, EXCHANGE_TIMES };

#ifndef WITHOUT_MODEL_EXCHANGE
/* Evaluate outputs and rates at the states of the importer, or after a communication step. */
Outcome exchange_read(Instance *i);

/* Set the importer's states to those of the start. */
Outcome exchange_begin(Instance *i);

void exchange_set_time(Instance *i, double time);
void exchange_set_states(Instance *i, const double *states);
void exchange_nominals(const Instance *i, double *found);

/* Accept the states of a step; `far` is whether an event has to correct them. */
Outcome exchange_accept(Instance *i, int *far);

/* Handle the events at this instant. `next` is the time [s] of the next known event, infinity if there is none. */
Outcome exchange_event(Instance *i, double *next);

/* Compute event indicators, which are positive before their events. */
Outcome exchange_indicate(Instance *i);
#else
static inline Outcome exchange_read(Instance *i) { return (void)i, REFUSED; }
static inline Outcome exchange_begin(Instance *i) { return (void)i, REFUSED; }
static inline void exchange_set_time(Instance *i, double time) { (void)i, (void)time; }
static inline void exchange_set_states(Instance *i, const double *states) { (void)i, (void)states; }
static inline void exchange_nominals(const Instance *i, double *found) { (void)i, (void)found; }
static inline Outcome exchange_accept(Instance *i, int *far) { return (void)i, (void)far, REFUSED; }
static inline Outcome exchange_event(Instance *i, double *next) { return (void)i, (void)next, REFUSED; }
static inline Outcome exchange_indicate(Instance *i) { return (void)i, REFUSED; }
#endif

/* Evaluate outputs, and rates of states if wanted; in Model Exchange rates are always evaluated. */
static inline Outcome exchange_or_read(Instance *i, int wanted)
{
    return wanted || i->flags.mode ? exchange_read(i) : instance_read(i);
}
