/* A mechanism in motion, as instance.py has it: values by reference, start, communication steps, outputs, state.

   Everything that evolves is in one array of numbers and a few flags, so that a state is a copy of both. What a scene
   is comes from its file: its functions and programs work on the memory `m` laid out by `Layout` in
   alfmu/kernel/program.py, and on the workspace behind it. */

#ifndef ALFMU_H
#define ALFMU_H

#include <stddef.h>
#include <stdint.h>

#include "baseline.h"
#include "lanes.h"
#include "layout.h"
#include "linear.h"

/* Also where an importer compiles this: other libraries have such names too (glibc: advance). */
#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility push(hidden)
#endif

#define MOST_ARGUMENTS 160 /* of a function, results included */
/* Most internal steps, or tries of them, in one communication step, so that every call comes back: the five-bar makes a
   million in 4 s, the flexible four-bar by a stiff method in 17 s. */
#ifndef MOST_STEPS
#define MOST_STEPS 1000000
#endif

/* What an instance counts beside the tally of its memory, and the largest errors that it has seen. */
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
    STEP_ERROR,   /* what the last communication step changed of the balance, over that */
    RUN_ERROR,    /* largest balance over it */
    AT_REST,      /* what communication steps at rest left, which is round-off of work and no part of the balance [J] */
    DRIFT,        /* how far the motion is off by what the balance makes of rates, where no work is done [rad or m] */
    COUNTED
};

/* A function of the scene as compiled code: arguments, results, and a workspace. */
typedef void Compiled(const double *const *x, double *const *y, double *w);

typedef enum { REAL, INTEGER, BOOLEAN, STRING } Type;
typedef enum { PARAMETER, CHOICE, INPUT, SWITCH, OUTPUT } Kind;

typedef struct {
    const char *name, *unit;
    Type type;
    Kind kind;
    double start, minimum, maximum;
    int instant; /* whether it follows inputs at once */
} Variable;

/* A variable that is text, and what it can be. */
typedef struct {
    int count, start;
    const char *const *values;
} Choice;

typedef struct {
    const char *name, *direction, *unit;
    double size; /* for a unit of displacement; 0 where the coefficients tell */
} Row;

typedef struct {
    const char *name, *unit;
} Coordinate;

/* A Boolean input and the rows that it concerns. */
typedef struct {
    int count;
    const int *rows;
    int holds, value, start;
} Switch;

/* An input that moves something, and how it goes on inside a communication step. */
typedef struct {
    int input, derivatives, order;
    double jump;
} Followed;

/* What is heard of it: how many points, of which derivative, their times and values. */
#define HEARD_POINTS 3
#define HEARD (2 + 2 * HEARD_POINTS)

/* A law of time that may jump, or not be finite: what it is, the units of it and of its rate, the constraint with which alone it counts, -1
   where it always does. */
typedef struct {
    const char *what, *unit, *rate_unit;
    int row;
} Leap;

/* A limit of a stop: its name, and the unit of what it limits. */
typedef struct {
    const char *name, *unit;
} Limit;

/* A joint with dry friction: the row that holds while it sticks, and where the displacement at which it does and the direction
   in which it slides stand among what is kept; whether its load is not unique. */
typedef struct {
    int row, value, slip, shared;
} Friction;

/* Where the nonzeros of a matrix stand, by columns. */
typedef struct {
    int rows, columns, entries;
    const int *offsets, *indices;
} Pattern;

/* An entry of the interface Jacobian: an output at the end of a communication step by an input that is held over it, which
   is one of so many directions. */
typedef struct {
    int output, input, direction;
} Jacobian_entry;

/* A function: runs of operations over places among the constants, the arguments, and what came before; behind them the
   places of its results. Places have 16 bits (narrow) or 32 (wide). */
typedef struct {
    int inputs, outputs, results;
    const int32_t *lengths; /* of arguments, then of results */
    const uint16_t *narrow;
    const int32_t *wide;
    size_t words;
    int registers; /* numbers that it works on, constants included */
    Compiled *compiled; /* in its place, where there is one */
} Function;

/* Calls of functions on the memory of an instance, choices, loops. */
typedef struct {
    const int32_t *code;
    size_t words;
} Program;

/* What alfmu/kernel/tables.py writes; numbers that are places stand for functions, programs, or where in the memory or the
   workspace something is (-1 for none). */
typedef struct {
    const char *name;
    char guid[40];
    unsigned body; /* check sum of the file but for its head: machine code names it */
#define NUMBER(name) int name;
    SCENE_NUMBERS(NUMBER)
#undef NUMBER
#define NUMBER(name) double name;
    SCENE_REALS(NUMBER)
#undef NUMBER
    /* Variables in the order of their references: parameters, choices, inputs, switches, outputs. The first parameters
       are those of the mechanism, then start values, start rates, compliances, states at the start, the solver's. */
    const Variable *variables;
    const Choice *choice;
    const Switch *switched;
    const Friction *friction;
    const int *impulse_rows, *event_places;
    const Coordinate *coordinates;
    const Row *rows;
    const int *angle_starts; /* start value that each computed angle begins near, -1 for none */
    const int *tied;         /* start values that are kept */
    const int *peak_parts;   /* readings that each peak is the magnitude of, -1 for none */
    const int *break_levels; /* of what changes its sign where something jumps or bends by itself */
    const double *normal;    /* standard normal numbers, TRIES x n; zero for time */
    int timed;               /* whether time is the last coordinate */
    int followed_count;
    const Followed *followed;
    int leap_count;
    int limit_count;
    const Limit *limited;
    const Leap *leaps;
    int entries, directions; /* of the interface Jacobian: its entries are variables behind all others */
    const Jacobian_entry *jacobian;
    Pattern mass, constraint, gaps, tie_rows;
    Envelope closing; /* J J' of the start, J being C or the gaps, and below them the start values that are kept */
    Envelope holding; /* M + C' C */
    const double *constants;
    const Function *functions;
    const Program *programs;
    int constant_count, function_count, program_count;
    int registers; /* numbers that the longest function works on, constants included */
    int lane_registers; /* of functions that are called in lanes */
    int spare;     /* workspace of compiled functions */
    int dense;     /* unknowns of the largest dense system */
    struct Block *blocks;
} Scene;

/* A scene from the bytes of its file; NULL, and why, where it is damaged. */
Scene *scene_load(const unsigned char *bytes, size_t size, char *why, size_t why_size);
void scene_free(Scene *s);

/* Compiled functions in place of the interpreted ones, before there is an instance: all of them in their order, and the
   numbers that the hungriest needs as workspace; 0 where they were made for another scene. */
int scene_compiled(Scene *s, Compiled *const *functions, int count, int spare, const char *identity);
int settings_length(const Scene *s);
size_t state_length(const Scene *s);
/* Quantities of first-order equations, and the length of what the equations call u: inputs, and behind them states. */
int states_of(const Scene *s);
int driven_by(const Scene *s);

/* CRC-32 of bytes that follow others; it begins with CHECK_BEGIN, and its complement is the check sum. */
#define CHECK_BEGIN 0xffffffffu
uint32_t check_sum_from(uint32_t sum, const unsigned char *bytes, size_t count);

/* The scene among the resources of an FMU, which the host names by a URI or a path. */
Scene *scene_of_fmu(const char *resources, char *why, size_t why_size);

/* Most times in a communication step at which something jumps or bends by itself. */
#define MOST_BREAKS 4096

typedef enum {
    DONE,
    REFUSED, /* a value or a call; nothing has changed */
    OPEN,    /* a step after which constraints cannot be closed */
    FAILED,
    UNHELD, /* a massless body that nothing holds */
    BRAKES, /* redundant constraints that the scene is not traced for */
    ENDED   /* no step leads on from here: a law of time breaks */
} Outcome;

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
    int phase, initialized, known, scaled, fast, whole, pending, brakes, given;
    int warned; /* of what, as bits */
    int choice[CHOICES];
} Flags;

typedef struct Instance {
    const Scene *scene;
    Flags flags;
    double *numbers;
    size_t count; /* of numbers */
    /* Parts of them. */
    double *values, *wanted, *on, *kept, *heard, *impulses, *lost, *slopes;
    double *penalty, *full, *units, *scales, *compliances;
    double *freedom, *masses, *regular, *rank, *largest_penalty, *length;
    double *peaks;         /* largest magnitudes within the last communication step, and what they are found with */
    double *jacobian;      /* of the last communication step */
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
    long shared;     /* evaluations that are in the tally and were not made, as what was read served, since the motion began */
    int within; /* whether the next step goes on in a communication step that began before */
    int crossings; /* jumps that were crossed by the shortest of steps, since there was a longer one */
    long left;  /* internal steps that this communication step may still take */
    double stop; /* time [s] past which the host does not step, as it said; INFINITY where it said none */
    int iterations; /* of the multiplier iteration that stopped last, 0 where none has run */
    int (*go_on)(struct Instance *i); /* asked now and then within a run in one call, where there is one; zero ends it */
    void *run;                        /* what that is about */
    long looks;                       /* how often it might have been asked */
    int ended;                        /* whether it ended the run */
    size_t used, room; /* of scratch */
    char text[1024];   /* what happened last */
    int warns;         /* whether there is a warning that nobody has read yet */
    char warning[1024];
    struct Tape *tape; /* what is done is written on it, where there is one (tape.h) */
    struct Gradient *gradient; /* of what is read at an instant, once a host has asked for it (partial.c) */
    struct Gradient *of_step;  /* of communication steps, where the scene has an interface Jacobian (jacobian.c) */
} Instance;

/* What an instance warns of once in a run. */
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
    EVERY_WARNING = 1023
};

Instance *instance_new(const Scene *scene);
void instance_free(Instance *i);
void instance_reset(Instance *i);
void instance_balance(Instance *i);
void instance_remember(Instance *i);
void instance_go_back(Instance *i);
void warn(Instance *i, int of, const char *format, ...);
int variable_count(const Scene *scene);
int outputs_from(const Scene *scene);

Outcome instance_set(Instance *i, int reference, double value);
double instance_get(const Instance *i, int reference);
const double *instance_place(const Instance *i, int reference);
void instance_get_many(const Instance *i, const int *references, int count, double *values);
Outcome instance_stabilise(Instance *i, double zeta, double omega, int projection);
Outcome instance_set_slope(Instance *i, int reference, double value);

Outcome instance_tolerate(Instance *i, double tolerance);
Outcome instance_begin(Instance *i, double start, double stop);
Outcome instance_initialize(Instance *i);
Outcome instance_can_step(Instance *i, double start, double h);
Outcome instance_ready(Instance *i, double start, double h);
Outcome instance_step(Instance *i, double start, double h);
Outcome instance_read(Instance *i);
Outcome instance_derivative(Instance *i, const unsigned *unknowns, size_t unknown_count, const unsigned *knowns,
    size_t known_count, const double *directions, double *changes);
/* The same by inputs, and before the run by parameters and start values: along a direction of what is known, or back from
   one of what is not. */
int has_derivatives(const Scene *s, int reference);
int moves_start(const Instance *i);
Outcome instance_sweep(Instance *i, const unsigned *unknowns, size_t unknown_count, const unsigned *knowns,
    size_t known_count, const double *seed, int back, double *found);
Outcome instance_output_derivatives(
    Instance *i, const unsigned *references, const int *orders, size_t count, double *values);
double *instance_time(Instance *i);
void at_time(Instance *i, double time);
int dependent(const Scene *scene);
Outcome instance_mobility(Instance *i, Counted_rows which, int *freedom, int *redundant, int *here, double *place);
Outcome instance_penalize(Instance *i, const double *penalties);

size_t state_size(const Instance *i);
void state_save(const Instance *i, unsigned char *state);
int state_whole(const Instance *i, const unsigned char *state, size_t size);
Outcome state_restore(Instance *i, const unsigned char *state, size_t size);

/* Between the parts of the runtime. */
Outcome say(Instance *i, Outcome outcome, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 3, 4)))
#endif
    ;
double *take(Instance *i, size_t count);
void spread(const Pattern *pattern, const double *nonzeros, double *dense, int rows);
const char *row_label(const Instance *i, int row, char *label, size_t size);
double *field(const Instance *i, int offset);
double verdict(const Instance *i, int which);
void constraints_at(
    Instance *i, const double *q, const double *v, double *mass, double *matrix, double *phi, double *cv);
double largest_of(const Instance *i, const double *x);
double widest(Instance *i, const double *q, const double *v, int of_velocity, int *row);
void in_force(const Instance *i, const double *on, unsigned char *held);

void parameters(Instance *i);
void count_turns(Instance *i);
void weigh(Instance *i);
void settle_kernel(Instance *i);
Outcome knowledge(Instance *i, const double *q, const double *v);
Outcome projected(Instance *i, double *q, double *v);
Outcome covered(Instance *i, double end, double dt, int once);
Outcome watched_step(Instance *i, double start, double dt);
Outcome plain_step(Instance *i, double start, double dt);
double brief(const Instance *i);
int method(const Instance *i);

/* The interface Jacobian (jacobian.c). */
Outcome jacobian_begin(Instance *i);
void jacobian_along(Instance *i);
Outcome jacobian_end(Instance *i);

/* Dry friction (friction.c). */
void friction_reset(Instance *i);
Outcome friction_begin(Instance *i);
Outcome friction_cover(Instance *i, double start, double h, double dt);
void friction_loosen(Instance *i);
int jammed(Instance *i);
Outcome say_jam(Instance *i);

Outcome assemble(Instance *i, const unsigned char *held, double *q, double *v);
void set_off(Instance *i, const unsigned char *held, const double *q, double *v);
Outcome check_masses(Instance *i, const double *q, const unsigned char *held);
Outcome check_agreement(Instance *i, const unsigned char *held, const double *q, const double *open, const char *per);
void warn_of_second_order(Instance *i, const unsigned char *held, const double *q);
void default_penalties(Instance *i, const double *q, double *penalties);
void know(Instance *i, const double *q, const double *v, const unsigned char *held, int usual);
int rank_here(Instance *i, const double *q, const unsigned char *held);
void hold(Instance *i);
void hand_over(Instance *i);

/* The program that leads to the end of a step by a formulation. */
int move_by(const Scene *s, int formulation);

/* Registers with what they begin with, once there is room for them: `lanes` from the first place that suits. */
double *lanes_from(double *place);
void registers_begin(Instance *i);

/* What a rare operation gives for its operands a and b, and its derivatives by them. */
double rare_value(int kind, double a, double b);
void partials(int kind, double a, double b, double of[2]);

/* What the operations of a function give, once its arguments stand in the registers. */
void evaluate(const Function *f, double *registers, double *values);

/* A function of the scene on arrays; a program on the memory. */
void call(Instance *i, int which, const double *const *x, double *const *y);
void run(Instance *i, int program);

void signals_begin(Instance *i, double time);
Outcome signals_aim(Instance *i, double start, double h);

Outcome breaks_found(Instance *i, double begin, double end);
size_t breaks_room(const Scene *s);
Outcome laws_checked(Instance *i, double end);
Outcome laws_begun(Instance *i, Outcome outcome);
size_t laws_room(const Scene *s);

/* Peaks (peaks.c). */
size_t peaks_length(const Scene *s);
size_t peaks_room(const Scene *s);
void peaks_begin(Instance *i);
void peaks_broken(Instance *i);
void peaks_along(Instance *i, const double *begin);
int read_away(Instance *i);

void arrive(Instance *i);
long advance(Instance *i, long steps, double dt);
int cover(Instance *i, double end, long tries);
int ended(Instance *i);
int communicate(Instance *i, double start, double h, long *made);
int read_quickly(Instance *i);

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility pop
#endif

#endif
