/* What a run did, written down so that it can be differentiated: each call of a function with the numbers that it was
   called with, each routine of linear algebra, each copy within the memory of an instance. Choices, tiers, accepted steps
   and ranks are those that were taken.

   Places are counted from the first number of an instance; what has no derivative (settings, step control, tallies) has
   the place -1. Tangents and adjoints belong to places, so that what the memory of an instance keeps between calls needs
   no words here. */

#ifndef ALFMU_TAPE_H
#define ALFMU_TAPE_H

#include "alfmu.h"

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility push(hidden)
#endif

typedef enum {
    CALLED,       /* a function; places of arguments and results */
    COPIED,       /* to, from, how many */
    CLEARED,      /* to, how many */
    COMBINED,     /* a number as a sum: to, from each; the factor of each */
    FACTORED,     /* n, blocks, terms, weights, parts, factors; weights and parts */
    SOLVED,       /* n, blocks, factors, right-hand sides, solution, where the factors are kept (two words); the solution */
    LEAST_NORMED, /* side, matrix, right-hand side, solution; all three */
    CLOSED,       /* a Gauss-Newton step of the start (closing.c) */
    RATED,        /* a correction of the start's velocities (closing.c) */
    HELD,         /* a rank that is frozen (closing.c) */
    AIMED         /* an input that moves something (signals.c) */
} Taped;

typedef struct {
    int32_t kind, what; /* of a call: the number of the function */
    size_t words, numbers;
} Entry;

/* How far a tape has come. */
typedef struct {
    size_t entries, words, numbers;
} Mark;

struct Tape {
    Entry *entries;
    int32_t *words;
    double *numbers;
    Mark used, room;
    Mark reading;        /* where outputs were begun to be read last */
    int factors;         /* place of the factors that were made last, -1 for none */
    size_t factors_kept; /* where they are among the numbers */
    int paused;
    int lost; /* whether there was no memory for all of it */
};
typedef struct Tape Tape;

Tape *tape_new(void);
void tape_free(Tape *t);
size_t tape_bytes(const Tape *t);
void tape_clear(Tape *t);

/* What an instance does from here on is on its tape, where it has one. */
Mark tape_mark(const Instance *i);
void tape_cut(Instance *i, Mark mark);
/* Writes nothing down from here on, or goes on; returns how it was before. */
int tape_pause(Instance *i, int paused);
int32_t place_of(const Instance *i, const double *number);
void tape_call(Instance *i, int which, const double *const *x, double *const *y);
void tape_call_at(Instance *i, const Function *f, const int32_t *at);
void tape_copy(Instance *i, const double *to, const double *from, size_t count);
void tape_clearing(Instance *i, const double *to, size_t count);
void tape_sum(Instance *i, const double *to, int terms, const double *const *from, const double *by);
void tape_factor(Instance *i, int n, int blocks, int terms, const double *weights, const double *const *parts,
    const double *factors, const double *order);
void tape_solve(Instance *i, int n, int blocks, const double *factors, const double *order, const double *const *right,
    const double *x);
void tape_least_norm(Instance *i, int side, const double *matrix, const double *right, const double *x);

/* Room for an entry with so many words and numbers; NULL where there is none, or no tape. */
Entry *tape_entry(Instance *i, Taped kind, int what, size_t words, size_t numbers);

/* A call of a function on arrays of the instance, written down. */
void taped_call(Instance *i, int which, const double *const *x, double *const *y);

/* A function as runs of equal operations over places of registers, loops written out. */
typedef struct {
    int32_t kind, count, result;
    const int32_t *operands;
} Run_of;
typedef struct {
    Run_of *runs;
    int32_t *operands;
    int count, first; /* runs; the first register behind the arguments */
    int registers;
} Flat;

/* What derivatives of an instance need beside it. */
typedef struct Gradient {
    Instance *instance;
    Tape *tape;
    Flat *flats;         /* of each function, made when it is first needed */
    int functions;
    size_t places;       /* numbers of the instance that have derivatives */
    int blocks;          /* of LANES directions */
    Lanes *tangents;     /* by blocks, of each place */
    Lanes *lane_registers;
    double *adjoints;    /* of each place */
    double *registers;   /* adjoints of those of a function */
    void *lanes_block;
    int lost;            /* whether there was no memory */
    /* A run that is swept back. */
    unsigned char *states; /* at the beginning of each window */
    long *windows;         /* row at which each begins */
    long window_count, window_room, rows;
    int swept; /* whether the tape has the first window, no longer the last */
    Mark *marks;           /* of the last window: where inputs were set at each row, and where the row ends */
} Gradient;

Gradient *gradient_new(Instance *i, int directions);
void gradient_free(Gradient *g); /* also once the instance is gone */
const Flat *flat_of(Gradient *g, int which);

/* Values of the registers of a function for saved arguments. */
double *values_again(Gradient *g, int which, const double *saved);
int32_t result_of(const Function *f, size_t k);

void tangents_along(Gradient *g, Mark from);
void adjoints_along(Gradient *g, Mark from);

/* Tangents and adjoints of a function, once its registers have their values and the arguments their tangents, or the
   results their adjoints. */
void tangents_through(const Flat *flat, const double *r, Lanes *dr);
void adjoints_through(const Flat *flat, const double *r, double *ar);

/* DONE, or what a run is not differentiated through (partial.c). */
Outcome differentiable(Instance *i);

/* Of the start (closing.c), of inputs that move something (signals.c). */
void closed_tangents(Gradient *g, const Entry *e);
void closed_adjoints(Gradient *g, const Entry *e);
void aimed_tangents(Gradient *g, const Entry *e);
void aimed_adjoints(Gradient *g, const Entry *e);
void held_tangents(Gradient *g, const Entry *e);
void held_adjoints(Gradient *g, const Entry *e);
void rated_tangents(Gradient *g, const Entry *e);
void rated_adjoints(Gradient *g, const Entry *e);

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility pop
#endif

#endif
