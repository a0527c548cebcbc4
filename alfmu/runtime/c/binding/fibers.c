/* makecontext creates a fiber; setjmp and longjmp switch fibers without a system call. */

#define _XOPEN_SOURCE 700
#undef _FORTIFY_SOURCE /* The checked longjmp refuses to change stacks. */

#include "fibers.h"

#include <stdlib.h>

#if (defined(__GLIBC__) || defined(__APPLE__)) && !defined(__SANITIZE_THREAD__)

#include <setjmp.h>
#include <ucontext.h>

#include "baseline.h"

#define STACK (256 * 1024) /* bytes: a step takes some 10 kB */

struct Fiber {
    void (*work)(void *what);
    void *what;
    jmp_buf inside, outside;
    ucontext_t context, caller;
    char *stack;
};

/* makecontext passes arguments of type int only. */
static void begin(unsigned high, unsigned low)
{
    Fiber *f = (Fiber *)(uintptr_t)((uint64_t)high << 32 | low);
    if (!_setjmp(f->inside))
        swapcontext(&f->context, &f->caller);
    for (;;) {
        f->work(f->what);
        fiber_leave(f);
    }
}

/* Begin a fiber on its stack; return whether this succeeded. */
static int is_begun(Fiber *const f)
{
    const uint64_t address = (uintptr_t)f;
    if (getcontext(&f->context))
        return 0;
    f->context.uc_stack.ss_sp = f->stack;
    f->context.uc_stack.ss_size = STACK;
    makecontext(&f->context, (void (*)(void))begin, 2, (unsigned)(address >> 32), (unsigned)address);
    return !swapcontext(&f->caller, &f->context);
}

Fiber *fiber_new(void (*work)(void *what), void *what)
{
    Fiber *f = calloc(1, sizeof *f);
    if (!f)
        return NULL;
    f->work = work;
    f->what = what;
    f->stack = malloc(STACK);
    if (f->stack && is_begun(f))
        return f;
    fiber_free(f);
    return NULL;
}

void fiber_free(Fiber *f)
{
    if (f)
        free(f->stack);
    free(f);
}

#if defined(__SANITIZE_ADDRESS__) /* the sanitizer follows swapcontext only */

void fiber_enter(Fiber *f)
{
    swapcontext(&f->caller, &f->context);
}

void fiber_leave(Fiber *f)
{
    swapcontext(&f->context, &f->caller);
}

#else

void fiber_enter(Fiber *f)
{
    if (!_setjmp(f->outside))
        _longjmp(f->inside, 1);
}

void fiber_leave(Fiber *f)
{
    if (!_setjmp(f->inside))
        _longjmp(f->outside, 1);
}

#endif

#else

Fiber *fiber_new(void (*work)(void *what), void *what)
{
    (void)work, (void)what;
    return NULL;
}

void fiber_free(Fiber *f)
{
    (void)f;
}

void fiber_enter(Fiber *f)
{
    (void)f;
}

void fiber_leave(Fiber *f)
{
    (void)f;
}

#endif
