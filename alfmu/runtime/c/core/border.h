/* The floating-point environment of a host, which may have unmasked traps or changed the rounding mode: during a call
   nothing traps, and results are the same for every host. If the host changed nothing, a call reads two registers. */

#pragma once

#include "baseline.h"

#if defined(__SSE2__) || defined(_M_X64)
#include <xmmintrin.h>
#define ALFMU_SSE 1
#endif

/* The environment of the host, if it was not the usual one. */
typedef struct {
    int changed;
#if defined(ALFMU_SSE)
    unsigned sse;
    unsigned x87[7]; /* as FNSTENV stores it */
#elif defined(__aarch64__) && defined(__GNUC__)
    uint64_t control;
#elif defined(FE_ALL_EXCEPT)
    fenv_t host;
#endif
} Border;

#if defined(ALFMU_SSE)

#define USUAL_SSE 0x1f80u  /* all traps masked, to nearest, with subnormal numbers, no flags */
#define FLAGS_SSE 0x3fu
#define MASKED_X87 0x3fu

static inline Border border_in(void)
{
    Border b = {0, _mm_getcsr(), {0}};
#if defined(__GNUC__)
    uint16_t control;
    __asm__ volatile("fnstcw %0" : "=m"(control));
    b.changed = (control & MASKED_X87) != MASKED_X87;
#endif
    b.changed |= (b.sse & ~FLAGS_SSE) != USUAL_SSE;
    if (b.changed) {
#if defined(__GNUC__)
        __asm__ volatile("fnstenv %0" : "=m"(b.x87) : : "memory"); /* fnstenv also masks the traps */
#endif
        _mm_setcsr(USUAL_SSE);
    }
    return b;
}

static inline void border_out(const Border *b)
{
    if (!b->changed)
        return;
#if defined(__GNUC__)
    __asm__ volatile("fldenv %0" : : "m"(b->x87) : "memory");
#endif
    _mm_setcsr(b->sse);
}

#elif defined(__aarch64__) && defined(__GNUC__)

static inline Border border_in(void)
{
    Border b;
    __asm__ volatile("mrs %0, fpcr" : "=r"(b.control) : : "memory");
    b.changed = b.control != 0;
    if (b.changed)
        __asm__ volatile("msr fpcr, %0" : : "r"((uint64_t)0) : "memory");
    return b;
}

static inline void border_out(const Border *b)
{
    if (b->changed)
        __asm__ volatile("msr fpcr, %0" : : "r"(b->control) : "memory");
}

#elif defined(FE_ALL_EXCEPT) /* source code on systems with <fenv.h> */

static inline Border border_in(void)
{
    Border b;
    b.changed = 1;
    feholdexcept(&b.host);
    fesetround(FE_TONEAREST);
    return b;
}

static inline void border_out(const Border *b)
{
    fesetenv(&b->host);
}

#else /* WebAssembly has no traps; on other targets the environment is left as it is. */

static inline Border border_in(void)
{
    const Border b = {0};
    return b;
}

static inline void border_out(const Border *b)
{
    (void)b;
}

#endif

/* Make a call with the default floating-point environment and return its result. */
#define INSIDE(TYPE, CALL) \
    do { \
        const Border border = border_in(); \
        TYPE given = (TYPE)(CALL); \
        border_out(&border); \
        return given; \
    } while (0)
