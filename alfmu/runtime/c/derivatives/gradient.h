/* Storage for the derivatives of an instance: tangents, adjoints, and functions as flat lists of operations. */

#ifndef ALFMU_GRADIENT_H
#define ALFMU_GRADIENT_H

#include <stddef.h>
#include <stdint.h>

#include "instance.h"
#include "lanes.h"
#include "record.h"
#include "scene.h"
#include "scene_features.h"

#include "internal_begin.h"

#if HAS_DERIVATIVES
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

/* Storage for the derivatives of an instance. */
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

const Flat *gradient_flat(Gradient *g, int which);
int32_t function_result_place(const Function *f, size_t k);

/* Values of the registers of a function for saved arguments. */
double *gradient_values_again(Gradient *g, int which, const double *saved);

Gradient *gradient_new(Instance *i, int directions);
void gradient_free(Gradient *g);
#else
static inline void gradient_free(struct Gradient *g) { (void)g; }
#endif

#include "internal_end.h"

#endif
