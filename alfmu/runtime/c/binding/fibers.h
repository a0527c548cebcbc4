/* Fibers: functions with stacks of their own in one thread, which can be suspended and resumed. */

#pragma once

typedef struct Fiber Fiber;

/* Return a fiber for some work; NULL if the platform has no fibers, or without memory. */
Fiber *fiber_new(void (*work)(void *what), void *what);
void fiber_free(Fiber *f);

/* fiber_enter runs a fiber until it calls fiber_leave, which returns when the fiber is entered again. */
void fiber_enter(Fiber *f);
void fiber_leave(Fiber *f);
