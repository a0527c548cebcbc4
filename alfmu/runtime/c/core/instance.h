/* An instance of a mechanism: the values of its variables, and all data that a communication step reads and changes.

   Everything that evolves is in one array of numbers and a few flags, so that a state is a copy of both. The scene
   comes from its file: its functions and programs work on the memory `m` laid out by `Layout` in
   alfmu/kernel/memory.py, and on the workspace after it. */

#pragma once

#include <assert.h>

#include "layout.h"
#include "scene.h"

#ifndef MESSAGE
#define MESSAGE 1024 /* most characters of a message */
#endif
#define MOST_ARGUMENTS 160 /* most arguments and results of a function */
/* Most internal steps of a communication step, rejected ones included, so that every call returns: the five-bar makes a
   million in 4 s, the flexible four-bar by a stiff method in 17 s. */
#ifndef MOST_STEPS
#define MOST_STEPS 1000000
#endif

/* Counters of an instance besides the tally in its memory, and its largest errors. */
enum {
    PATIENT_STEPS,
    READS,
    QUICK_READS, /* readings by the few iterations of a quick step */
    UNCONVERGED,
    POSITION_ERROR,
    VELOCITY_ERROR,
    ACCELERATION_ERROR,
    ENERGY_ERROR,
    ENERGY_START,
    BALANCE,      /* energy - energy at the start - work, after the last communication step [J] */
    ENERGY_SCALE, /* largest kinetic energy and largest work so far [J] */
    STEP_ERROR,   /* change of the balance in the last communication step over ENERGY_SCALE */
    RUN_ERROR,    /* largest balance over ENERGY_SCALE */
    /* balance left by communication steps at rest: round-off of the work, excluded from BALANCE [J] */
    AT_REST,
    DRIFT,        /* estimated drift of positions that the balance shows if no work is done [rad or m] */
    COUNTED
};

typedef enum {
    DONE,
    REFUSED, /* a value or a call is refused; nothing has changed */
    CONSTRAINT_OPEN,    /* constraints cannot be closed after a step */
    FAILED,
    UNHELD_BODY, /* no constraint holds a massless body */
    RANK_CHANGES, /* the scene is not traced for redundant constraints */
    NO_STEP_ON   /* no step continues from here: a law of time breaks */
} Outcome;

/* Mode of an instance in Model Exchange; 0 in co-simulation. */
typedef enum { AT_EVENT = 1, CONTINUOUS } Mode;

/* Constraints that are regarded when degrees of freedom are counted (`COUNTED_ROWS` in probe.py). */
typedef enum { ROWS_IN_FORCE, ALL_ROWS, NO_FRICTION } Counted_rows;

/* Phases of an instance, as bits, so that a call can name every phase in which it is legal. */
typedef enum {
    INSTANTIATED = 1,
    INITIALIZING = 2,
    STEPPING = 4,
    TERMINATED = 8,
    LOOKING = 16, /* the host reads between internal steps */
    BORN = INSTANTIATED | INITIALIZING | STEPPING,
    RUN = STEPPING | TERMINATED,
    ANY = BORN | TERMINATED,
    KNOWN = INITIALIZING | STEPPING | TERMINATED | LOOKING
} Phase;

typedef struct {
    int phase, initialized, known, scaled, fast, whole, pending, brakes, given, mode;
    int warned; /* bits of the warnings given so far */
    int choice[CHOICES];
} Flags;

typedef struct Instance {
    const Scene *scene;
    Flags flags;
    double *numbers;
    size_t count; /* length of `numbers` */
    /* Parts of `numbers`. */
    double *values, *requested, *active, *discrete, *input_history, *impulses, *dissipated, *slopes;
    double *penalty, *full, *units, *scales, *compliances;
    double *freedom, *masses, *least_margin, *regular, *rank, *largest_penalty, *length, *loop, *agreed;
    /* largest magnitudes within the last communication step, and the samples from which they are found */
    double *peaks;
    double *jacobian;      /* interface Jacobian of the last communication step */
    double *exchange;      /* states as an importer integrates them, and their rates (exchange.c) */
    double *given;         /* penalty of each constraint if `flags.given` is set */
    double *counts;        /* [COUNTED] */
    double *stabilisation; /* zeta and omega [1/s] of (6), (5) and Baumgarte's form of (9) */
    double *projection;    /* whether steps end with projections (10); below zero, the formulation decides */
    double *m;
    /* Memory besides `numbers`. */
    double *workspace, *before, *scratch, *registers, *lanes, *spare, *past_before, *kept_before, *dense;
    Flags flags_before;
    double *breaks;  /* times at which a law jumps or bends in this step, in pairs: just before, just after */
    int broken;      /* number of pairs in `breaks` */
    double *read_at; /* q, v and inputs at the last reading of outputs */
    int onward;      /* whether the workspace holds the evaluation there, with which a quick step begins */
    /* evaluations in the tally that were not made, most of them taken over from outputs, since the motion began */
    long shared;
    int within; /* whether the next step continues a communication step */
    int crossings; /* jumps crossed by the shortest steps since the last longer one */
    long left;  /* internal steps that this communication step may still take */
    double stop; /* time [s] beyond which the host does not step; INFINITY if it gave none */
    int iterations; /* iterations of the last multiplier iteration, 0 if none has run */
    /* called now and then within a run in one call, or NULL; the run ends if it returns zero */
    int (*go_on)(struct Instance *i);
    void *run;                        /* argument of `go_on` */
    long looks;                       /* counts internal steps; `go_on` is called every LOOK of them */
    int ended;                        /* whether `go_on` has ended the run */
    /* called instead of running a program, or a function on arrays, if instances run together (batch.c), or NULL */
    void (*wait)(struct Instance *i, int which, const double *const *x, double *const *y);
    void *place; /* argument of `wait` */
    size_t used, room; /* of scratch */
    char text[MESSAGE]; /* last message */
    int warns;         /* whether there is an unread warning */
    char warning[MESSAGE];
    struct Tape *tape; /* tape that records the calls, or NULL (record.h) */
    /* derivatives of outputs at an instant, once a host has asked for them (instant_derivatives.c) */
    struct Gradient *gradient;
    /* derivatives of communication steps, if the scene has an interface Jacobian (interface_jacobian.c) */
    struct Gradient *of_step;
} Instance;

/* Warnings that an instance gives once in a run. */
enum {
    WARNED_OF_BALANCE = 1,
    WARNED_OF_ROUND_OFF = 2,
    WARNED_OF_UNCONVERGED = 4,
    WARNED_OF_FRICTION = 8,
    WARNED_OF_IMPACT = 16,
    WARNED_OF_CORNER = 32,
    WARNED_OF_PENALTY = 64,
    WARNED_OF_TIME = 128,
    WARNED_OF_SECOND_ORDER = 256,
    WARNED_OF_DRIFT = 512,
    WARNED_OF_REST = 1024,
    WARNED_OF_IMPORTER = 2048,
    WARNED_OF_REACH = 4096,
    WARNED_OF_SHARES = 8192,
    EVERY_WARNING = 16383
};

/* The arena: numbers are allocated in order, and released together back to a mark. */
static inline size_t arena_mark(const Instance *i)
{
    return i->used;
}

static inline void arena_release(Instance *i, size_t mark)
{
    i->used = mark;
}

static inline void arena_reset(Instance *i)
{
    i->used = 0;
}

static inline double *instance_field(const Instance *i, int offset)
{
    return i->m + offset;
}

/* Return one of the diagnostics stored after the outputs. */
static inline double instance_diagnostic(const Instance *i, int which)
{
    return i->m[i->scene->seen + i->scene->seen_size - SEEN + which];
}

static inline double *instance_time(Instance *i)
{
    return i->m + i->scene->z + i->scene->time;
}

/* Set the time of the state, which is also the last coordinate if positions depend on it. */
static inline void instance_set_time(Instance *i, double time)
{
    const Scene *s = i->scene;
    *instance_time(i) = time;
    if (s->timed)
        instance_field(i, s->z)[s->n - 1] = time;
}

/* Return the number of coordinates without time. */
static inline int scene_coordinates(const Scene *s)
{
    return s->n - s->timed;
}

static inline double *arena_alloc(Instance *i, size_t count)
{
    double *taken = i->scratch + i->used;
    i->used += count;
    assert(i->used <= i->room);
    return taken;
}

/* Return the first-order states. */
static inline double *instance_states(const Instance *i)
{
    return instance_field(i, i->scene->z) + i->scene->work + 1;
}

/* Return the remainder of a communication step, or distance to an event [s], below which error control is useless:
   other methods leave it to RK4. A host that sums up its step sizes may leave such a remainder. */
static inline double instance_least_step(const Instance *i)
{
    return fmax(LEFT_TO_RK4 * GIVEN_UP, LAST_DIGITS * DBL_EPSILON * fabs(i->m[i->scene->z + i->scene->time]));
}
