/* Fibers: functions that stop in the middle and go on later, each on a stack of its own, all in one thread. */

#ifndef ALFMU_FIBERS_H
#define ALFMU_FIBERS_H

#include "internal_begin.h"

typedef struct Fiber Fiber;

/* Return a fiber that will do some work; NULL where the platform has none, or no memory. */
Fiber *fiber_new(void (*work)(void *what), void *what);
void fiber_free(Fiber *f);

/* Run a fiber until it leaves; leave it from inside, until it is entered again. */
void fiber_enter(Fiber *f);
void fiber_leave(Fiber *f);

#include "internal_end.h"

#endif
