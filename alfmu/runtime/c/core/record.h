/* The record of a run, from which it is differentiated: each call of a function with its arguments, each routine of
   linear algebra, each copy within the memory of an instance. Choices, tiers, accepted steps and ranks are kept as
   taken.

   Places are counted from the first number of an instance; a number without derivative (settings, step control,
   tallies) has the place -1. Tangents and adjoints belong to places, so that values kept in memory between calls need
   no entry. */

#pragma once

#include "instance.h"
#include "scene.h"

typedef enum {
    CALLED,       /* a function; words: places of arguments and results; numbers: arguments */
    COPIED,       /* words: to, from, count */
    CLEARED,      /* words: to, count */
    COMBINED,     /* a weighted sum; words: to, from of each term; numbers: weights */
    FACTORED,     /* words: n, blocks, terms, weights, parts, factors; numbers: weights and parts */
    /* words: n, blocks, factors, right-hand sides, solution, index of the kept factors (two); numbers: solution */
    SOLVED,
    LEAST_NORMED, /* words: side, matrix, right-hand side, solution; numbers: the last three */
    CLOSED,       /* a Gauss-Newton step of the start (start_derivatives.c) */
    RATED,        /* a correction of the start's velocities (start_derivatives.c) */
    HELD,         /* a frozen rank (start_derivatives.c) */
    AIMED         /* the polynomial of a driving input (driving_inputs.c) */
} Taped;

typedef struct {
    int32_t kind, what; /* `what`: number of the function of a call */
    size_t words, numbers;
} Entry;

/* A position on a tape. */
typedef struct {
    size_t entries, words, numbers;
} Mark;

struct Tape {
    Entry *entries;
    int32_t *words;
    double *numbers;
    Mark used, room;
    Mark reading;        /* position where the last reading of outputs begins */
    int factors;         /* place in the instance of the latest factors, -1 for none */
    size_t factors_kept; /* index of these factors in `numbers` */
    int paused;
    int lost; /* whether memory ran out, so that the record is incomplete */
};
typedef struct Tape Tape;

/* Words of a correction. Numbers: arguments of closure (and constraints), weights of rows and columns, x, lam; part. */
enum { PLACE_Q, PLACE_P, PLACE_STARTS, PLACE_V, PLACE_RATES, PLACE_COUNT };

#ifndef WITHOUT_DERIVATIVES
Tape *tape_new(void);
void tape_free(Tape *t);
size_t tape_bytes(const Tape *t);
void tape_clear(Tape *t);

/* Append an entry with space for words and numbers; return NULL if memory is short or there is no tape. */
Entry *tape_entry(Instance *i, Taped kind, int what, size_t words, size_t numbers);

/* Mark a position on the tape, and cut the tape there. */
Mark tape_mark(const Instance *i);

void tape_cut(Instance *i, Mark mark);

/* Mark where the last reading of outputs begins. */
void tape_begin_reading(Instance *i);

/* Pause or resume recording; return whether it was paused before. */
int tape_pause(Instance *i, int paused);

int32_t tape_place_of(const Instance *i, const double *number);
void tape_call_at(Instance *i, const Function *f, const Word *at);
void tape_call(Instance *i, int which, const double *const *x, double *const *y);
void tape_copy(Instance *i, const double *to, const double *from, size_t count);
void tape_clearing(Instance *i, const double *to, size_t count);
void tape_sum(Instance *i, const double *to, int terms, const double *const *from, const double *by);
void tape_factor(Instance *i, int n, int blocks, int terms, const double *weights, const double *const *parts,
    const double *factors, const double *order);
void tape_solve(Instance *i, int n, int blocks, const double *factors, const double *order, const double *const *right,
    const double *x);
void tape_least_norm(Instance *i, int side, const double *matrix, const double *right, const double *x);
size_t arguments_of(const Function *f);

/* Record a step of the assembly (v is NULL) or a correction of its velocities: x of least norm, with weights of rows
   and columns. */
void tape_correction(Instance *i, const double *rows, const double *columns, const double *q, const double *v,
    const double *x, const double *lam, double part);

/* Record the constraints of a frozen rank at q. */
void tape_holding(Instance *i, const double *q, const double *matrix);
#else
static inline Entry *tape_entry(Instance *i, Taped kind, int what, size_t words, size_t numbers)
{
    return (void)i, (void)kind, (void)what, (void)words, (void)numbers, NULL;
}
static inline Mark tape_mark(const Instance *i)
{
    const Mark none = {0, 0, 0};
    return (void)i, none;
}
static inline void tape_cut(Instance *i, Mark mark) { (void)i, (void)mark; }
static inline void tape_begin_reading(Instance *i) { (void)i; }
static inline int tape_pause(Instance *i, int paused) { return (void)i, paused; }
static inline int32_t tape_place_of(const Instance *i, const double *number) { return (void)i, (void)number, -1; }
static inline void tape_call_at(Instance *i, const Function *f, const Word *at) { (void)i, (void)f, (void)at; }
static inline void tape_call(Instance *i, int which, const double *const *x, double *const *y)
{
    (void)i, (void)which, (void)x, (void)y;
}
static inline void tape_copy(Instance *i, const double *to, const double *from, size_t count)
{
    (void)i, (void)to, (void)from, (void)count;
}
static inline void tape_clearing(Instance *i, const double *to, size_t count) { (void)i, (void)to, (void)count; }
static inline void tape_sum(Instance *i, const double *to, int terms, const double *const *from, const double *by)
{
    (void)i, (void)to, (void)terms, (void)from, (void)by;
}
static inline void tape_factor(Instance *i, int n, int blocks, int terms, const double *weights,
    const double *const *parts, const double *factors, const double *order)
{
    (void)i, (void)n, (void)blocks, (void)terms, (void)weights, (void)parts, (void)factors, (void)order;
}
static inline void tape_solve(Instance *i, int n, int blocks, const double *factors, const double *order,
    const double *const *right, const double *x)
{
    (void)i, (void)n, (void)blocks, (void)factors, (void)order, (void)right, (void)x;
}
static inline void tape_least_norm(Instance *i, int side, const double *matrix, const double *right, const double *x)
{
    (void)i, (void)side, (void)matrix, (void)right, (void)x;
}
static inline void tape_correction(Instance *i, const double *rows, const double *columns, const double *q,
    const double *v, const double *x, const double *lam, double part)
{
    (void)i, (void)rows, (void)columns, (void)q, (void)v, (void)x, (void)lam, (void)part;
}
static inline void tape_holding(Instance *i, const double *q, const double *matrix) { (void)i, (void)q, (void)matrix; }
#endif
