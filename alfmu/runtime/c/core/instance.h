/* A mechanism in motion: values by reference, and all that a communication step reads and changes.

   Everything that evolves is in one array of numbers and a few flags, so that a state is a copy of both. The scene
   comes from its file: its functions and programs work on the memory `m` laid out by `Layout` in
   alfmu/kernel/memory.py, and on the workspace behind it. */

#ifndef ALFMU_INSTANCE_H
#define ALFMU_INSTANCE_H

#include <assert.h>
#include <float.h>
#include <math.h>
#include <stddef.h>

#include "layout.h"
#include "scene.h"

#include "internal_begin.h"

#ifndef MESSAGE
#define MESSAGE 1024 /* of a message, at most */
#endif
#define MOST_ARGUMENTS 160 /* of a function, results included */
/* Most internal steps, or tries of them, in one communication step, so that every call comes back: the five-bar makes a
   million in 4 s, the flexible four-bar by a stiff method in 17 s. */
#ifndef MOST_STEPS
#define MOST_STEPS 1000000
#endif

/* Counters of an instance beside the tally of its memory, and the largest errors so far. */
enum {
    PATIENT_STEPS,
    READS,
    QUICK_READS, /* those by the few iterations of a quick step */
    UNCONVERGED,
    POSITION_ERROR,
    VELOCITY_ERROR,
    ACCELERATION_ERROR,
    ENERGY_ERROR,
    ENERGY_START,
    BALANCE,      /* of energies after the last communication step: energy - energy at the start - work [J] */
    ENERGY_SCALE, /* largest kinetic energy and largest work so far [J] */
    STEP_ERROR,   /* change of the balance in the last communication step, over that scale */
    RUN_ERROR,    /* largest balance over it */
    /* balance left by communication steps at rest, which is round-off of work and no part of the balance [J] */
    AT_REST,
    DRIFT,        /* distance that the motion is off, from the balance, where no work is done [rad or m] */
    COUNTED
};

typedef enum {
    DONE,
    REFUSED, /* a value or a call; nothing has changed */
    CONSTRAINT_OPEN,    /* a step after which constraints cannot be closed */
    FAILED,
    UNHELD_BODY, /* a massless body that nothing holds */
    RANK_CHANGES, /* redundant constraints that the scene is not traced for */
    NO_STEP_ON   /* no step leads on from here: a law of time breaks */
} Outcome;

/* What an importer does with an instance of Model Exchange; 0 where it makes communication steps. */
typedef enum { AT_EVENT = 1, CONTINUOUS } Mode;

/* Constraints of which degrees of freedom are told (`COUNTED_ROWS` in probe.py). */
typedef enum { ROWS_IN_FORCE, ALL_ROWS, NO_FRICTION } Counted_rows;

/* Phases of life, as bits, so that a call can name all in which it is legal. */
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
    size_t count; /* of numbers */
    /* Parts of them. */
    double *values, *requested, *active, *discrete, *input_history, *impulses, *dissipated, *slopes;
    double *penalty, *full, *units, *scales, *compliances;
    double *freedom, *masses, *least_margin, *regular, *rank, *largest_penalty, *length;
    /* largest magnitudes within the last communication step, and the samples that they are found from */
    double *peaks;
    double *jacobian;      /* of the last communication step */
    double *exchange;      /* states as an importer integrates them, and their rates (exchange.c) */
    double *given;         /* penalties of each constraint, where `flags.given` says so */
    double *counts;        /* COUNTED */
    double *stabilisation; /* zeta and omega [1/s] of (6), (5) and Baumgarte's form of (9) */
    double *projection;    /* whether steps end with projections (10); below zero as the formulation has it */
    double *m;
    /* Beside them. */
    double *workspace, *before, *scratch, *registers, *lanes, *spare, *past_before, *kept_before, *dense;
    Flags flags_before;
    double *breaks;  /* times about which something jumps or bends by itself in this step: just before, just after */
    int broken;      /* how many */
    double *read_at; /* q, v and inputs where outputs were read last */
    int onward;      /* whether the workspace has the evaluation there that a quick step begins with */
    /* evaluations in the tally that steps took from the outputs instead of making them, since the motion began */
    long shared;
    int within; /* whether the next step goes on in a communication step that began before */
    int crossings; /* jumps that were crossed by the shortest of steps, since there was a longer one */
    long left;  /* internal steps that this communication step may still take */
    double stop; /* time [s] past which the host does not step, as it said; INFINITY where it said none */
    int iterations; /* of the multiplier iteration that stopped last, 0 where none has run */
    /* called now and then within a run in one call, or NULL; zero ends the run */
    int (*go_on)(struct Instance *i);
    void *run;                        /* argument of `go_on` */
    long looks;                       /* how often it might have been asked */
    int ended;                        /* whether it ended the run */
    /* called in place of running a program, or a function on arrays, by instances that run them together (batch.c), or
       NULL */
    void (*wait)(struct Instance *i, int which, const double *const *x, double *const *y);
    void *place; /* argument of `wait` */
    size_t used, room; /* of scratch */
    char text[MESSAGE]; /* last message */
    int warns;         /* whether there is a warning that nobody has read yet */
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
    EVERY_WARNING = 2047
};

/* The arena: numbers that are handed out in order and given back as a whole to where it was marked. */
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

/* One of the diagnostics stored after the outputs. */
static inline double instance_diagnostic(const Instance *i, int which)
{
    return i->m[i->scene->seen + i->scene->seen_size - SEEN + which];
}

static inline double *instance_time(Instance *i)
{
    return i->m + i->scene->z + i->scene->time;
}

/* The state at a time, which is also the last coordinate where places depend on it. */
static inline void instance_set_time(Instance *i, double time)
{
    const Scene *s = i->scene;
    *instance_time(i) = time;
    if (s->timed)
        instance_field(i, s->z)[s->n - 1] = time;
}

/* Coordinates without time. */
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

/* Quantities of first-order equations now. */
static inline double *instance_states(const Instance *i)
{
    return instance_field(i, i->scene->z) + i->scene->work + 1;
}

/* Remainder of a communication step, or distance to an event, below which error control is of no use: other methods
   leave it to RK4. A host that sums up its steps may add such a last step. */
static inline double instance_least_step(const Instance *i)
{
    return fmax(LEFT_TO_RK4 * GIVEN_UP, LAST_DIGITS * DBL_EPSILON * fabs(i->m[i->scene->z + i->scene->time]));
}

#include "internal_end.h"

#endif
