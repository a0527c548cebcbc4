/* A mechanism in motion, as alfmu/runtime.py has it: values by reference, start, communication steps, outputs, state.

   Everything that evolves is in one array of numbers and a few flags, so that a state is a copy of both. What a scene
   is comes from generated code: its functions and programs work on the memory `m` laid out by `Layout` in
   alfmu/kernel/program.py, and on the workspace behind it. */

#ifndef ALFMU_H
#define ALFMU_H

#include <stddef.h>

#include "constants.h"

#if !defined(EXPORT) /* in generated code, which has these */
typedef const double *const *Arguments;
typedef double *const *Results;
typedef void Function(Arguments, Results, double *);
#endif
typedef void Program(double *m, double *w);

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

/* Where the nonzeros of a matrix stand, by columns; without `offsets` it is dense. */
typedef struct {
    int rows, columns;
    const int *offsets, *indices;
} Pattern;

typedef struct {
    const char *name, *guid;
    /* Variables in the order of their references: parameters, choices, inputs, switches, outputs. */
    const Variable *variables;
    int parameters, choices, inputs, switches, outputs;
    const Choice *choice;
    /* The first parameters are those of the mechanism, then start values, start rates, compliances, the solver's. */
    int own, starts, compliances, solver;
    /* Places among the parameters. */
    int step_size, penalty, tolerance, max_iterations, relative_tolerance, absolute_tolerance;
    int branch, continues, method_choice; /* places of choices, and of a value of the first */
    double no_slope; /* of an input whose derivative is not given: 0, held; infinite, extrapolated from the past */
    const Switch *switched;
    int held;                  /* displacements that locks keep */
    int impulses, event_count; /* of all impacts; outputs that say something of them */
    const int *impulse_rows, *event_places;
    int n, l, angles, readings;
    const Coordinate *coordinates;
    const Row *rows;
    const int *angle_starts; /* start value that each computed angle begins near, -1 for none */
    int ties;
    const int *tied; /* start values that are kept */
    int freedom;     /* of the usual constraints, -1 where it is not known */
    int brakes, weighted, same_tiers, careful_iterations;
    int method;             /* 0 RK4, 1 one with error control, 2 another in steps of one length */
    double share, exponent; /* that make the tolerance of a run that of a step */
    const double *normal; /* standard normal numbers, TRIES x n */
    /* Memory: offsets of fields, entries of the state, lengths. */
    int z, after, begin, u, p, k, dt, control, pace, past, past_size, seen, seen_size;
    int time, work, trouble, size, workspace;
    /* Workspace: what programs hand on. */
    int most, patient, du, slopes, within, q, v, watch[4], near, dy, struck, impulse, lost;
    Pattern mass, constraint, gaps, tie_rows;
    Function *dynamics, *constraints, *energy, *closure, *guesses, *displacements;
    Function *pivots, *place, *bring, *settle;
    Program *move, *move_on_branch, *close, *instant, *limit, *impact, *sensitivity, *limit_sensitivity, *reach;
    long (*advance)(double *m, long steps, double dt);
    int (*communicate)(double *m, double start, double h);
    int (*cover)(double *m, double end, long tries);
    int (*read)(double *m);
} Scene;

extern const Scene alfmu_scene;

typedef enum {
    DONE,
    REFUSED, /* a value or a call; nothing has changed */
    OPEN,    /* a step after which constraints cannot be closed */
    FAILED
} Outcome;

typedef struct {
    int initialized, running, known, scaled, fast, whole, pending, brakes;
    int choice[3];
} Flags;

typedef struct {
    const Scene *scene;
    Flags flags;
    double *numbers;
    size_t count; /* of numbers */
    /* Parts of them. */
    double *values, *wanted, *on, *kept, *impulses, *lost, *slopes;
    double *penalty, *full, *units, *scales, *compliances;
    double *freedom, *masses, *regular, *rank, *largest_penalty;
    double *m;
    /* Beside them. */
    double *workspace, *before, *scratch;
    Flags flags_before;
    int within; /* whether the next step goes on in a communication step that began before */
    long left;  /* internal steps that this communication step may still take */
    size_t used, room; /* of scratch */
    char text[1024];   /* what happened last */
} Instance;

Instance *instance_new(const Scene *scene);
void instance_free(Instance *i);
void instance_reset(Instance *i);
int variable_count(const Scene *scene);

Outcome instance_set(Instance *i, int reference, double value);
double instance_get(const Instance *i, int reference);
Outcome instance_set_slope(Instance *i, int reference, double value);

Outcome instance_tolerate(Instance *i, double tolerance);
Outcome instance_initialize(Instance *i);
Outcome instance_can_step(Instance *i, double start, double h);
Outcome instance_step(Instance *i, double start, double h);
Outcome instance_read(Instance *i);
Outcome instance_derivative(Instance *i, const unsigned *unknowns, size_t unknown_count, const unsigned *knowns,
    size_t known_count, const double *directions, double *changes);
Outcome instance_output_derivatives(
    Instance *i, const unsigned *references, const int *orders, size_t count, double *values);
double *instance_time(Instance *i);

size_t state_size(const Instance *i);
void state_save(const Instance *i, unsigned char *state);
int state_running(const unsigned char *state);
Outcome state_restore(Instance *i, const unsigned char *state, size_t size);

/* Between the parts of the runtime. */
Outcome say(Instance *i, Outcome outcome, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 3, 4)))
#endif
    ;
double *take(Instance *i, size_t count);
void spread(const Pattern *pattern, const double *nonzeros, double *dense);
int nonzeros(const Pattern *pattern);
const char *row_label(const Instance *i, int row, char *label, size_t size);
double *field(const Instance *i, int offset);
void constraints_at(
    Instance *i, const double *q, const double *v, double *mass, double *matrix, double *phi, double *cv);
double widest(Instance *i, const double *q, const double *v, int of_velocity, int *row);
void in_force(const Instance *i, const double *on, unsigned char *held);

Outcome assemble(Instance *i, const unsigned char *held, double *q, double *v);
Outcome check_masses(Instance *i, const double *q, const unsigned char *held);
void default_penalties(Instance *i, const double *q, double *penalties);
void know(Instance *i, const double *q, const double *v, const unsigned char *held, int usual);
void hold(Instance *i);
void hand_over(Instance *i);

#endif
