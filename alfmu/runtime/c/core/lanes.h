/* Numbers in lanes: several values of a number side by side, for vector instructions of the processor. */

#pragma once

#include "scene.h"

#define LANES 8 /* argument sets of a function evaluated at once; directions of derivatives in a block */

#if defined(__GNUC__)
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__has_attribute) && !defined(__SANITIZE_THREAD__)
#if __has_attribute(target_clones)
#define BY_PROCESSOR __attribute__((target_clones("avx2", "default")))
#endif
#endif
#if defined(BY_PROCESSOR) /* The loader chooses the version for this processor before a thread sanitizer starts. */
#define PART 4
#else
#define BY_PROCESSOR
#define PART 2
#endif
typedef double Vector __attribute__((vector_size(8 * PART)));
/* Four numbers at any address. */
typedef double Four __attribute__((vector_size(32), aligned(8), may_alias));
#define FOUR(address) (*(Four *)(void *)(address))
#define EACH_PART _Pragma("GCC unroll 8") for (int part = 0; part < LANES / PART; part++)
#else /* Compilers without vectors. */
#define BY_PROCESSOR
#define PART 1
typedef double Vector;
#define EACH_PART for (int part = 0; part < LANES / PART; part++)
#endif

typedef union {
    Vector part[LANES / PART];
    double lane[LANES];
} Lanes;

#if defined(__GNUC__)
/* Return how many instances a function compiled for this processor evaluates at once: 4 or LANES. */
int lanes_compiled(void);

/* Copy `length` numbers at each of x[lanes] to rows of `lanes` numbers: 4 or LANES. */
void lanes_gather(double *rows, int lanes, const double *const *x, int length);

/* Evaluate a function with narrow places in all lanes; its arguments are in the registers before its values. */
void lanes_evaluate(const Function *f, Lanes *r);

/* Copy numbers of these rows, of the first `length` ones if `from` is NULL, to y[lane] for the first `count` lanes. */
void lanes_scatter(const double *rows, int lanes, const uint16_t *from, double *const *y, int length, int count);
#endif

/* Return the first address from `place` on at which lanes are aligned with cache lines. */
double *lanes_align(double *place);
