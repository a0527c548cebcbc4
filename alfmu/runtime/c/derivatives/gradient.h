/* Storage for the derivatives of an instance: tangents, adjoints, and functions as flat lists of operations. */

#pragma once

#include "instance.h"
#include "lanes.h"
#include "record.h"
#include "scene.h"

#ifndef WITHOUT_DERIVATIVES
/* A function as runs of equal operations on registers, with loops unrolled. */
typedef struct {
    int32_t kind, count, result;
    const int32_t *operands;
} Run_of;
typedef struct {
    Run_of *runs;
    int32_t *operands;
    int count, first; /* number of runs; first register after the arguments */
    int registers;
} Flat;

/* Storage for the derivatives of an instance. */
typedef struct Gradient {
    Instance *instance;
    Tape *tape;
    Flat *flats;         /* [functions] each is made when first needed */
    int functions;
    size_t places;       /* number of places of the instance that have derivatives */
    int blocks;          /* blocks of LANES directions */
    Lanes *tangents;     /* [blocks * places] */
    Lanes *lane_registers;
    double *adjoints;    /* [places] */
    double *registers;   /* adjoints of a function's registers */
    void *lanes_block;
    int lost;            /* whether memory ran out */
    /* A recorded run, for a backward sweep. */
    unsigned char *states; /* saved state at the start of each window */
    long *windows;         /* first row of each window */
    long window_count, window_room, rows;
    int swept; /* whether the tape holds the first window instead of the last */
    Mark *marks;           /* of the window on the tape: for each row, where its inputs are set and where it ends */
} Gradient;

const Flat *gradient_flat(Gradient *g, int which);
int32_t function_result_place(const Function *f, size_t k);

/* Evaluate the registers of a function again for saved arguments. */
double *gradient_values_again(Gradient *g, int which, const double *saved);

Gradient *gradient_new(Instance *i, int directions);
void gradient_free(Gradient *g);
#else
typedef struct Gradient Gradient;
static inline void gradient_free(struct Gradient *g) { (void)g; }
#endif

/* Propagates adjoints back along a tape. Only those who need adjoints name such a function, so that libraries for
   FMI 2, which has none, leave it out. */
typedef void Sweep(Gradient *g, Mark from);
