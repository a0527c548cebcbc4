/* A scene: the equations of a mechanism as functions and programs, its variables and its sizes, as a scene file holds
   them. */

#ifndef ALFMU_SCENE_H
#define ALFMU_SCENE_H

#include <stddef.h>
#include <stdint.h>

#include "layout.h"
#include "linear.h"

#include "internal_begin.h"

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

/* A text variable and its possible values. */
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

/* History of such an input: the number of points, the derivative that they are of, their times and values. */
#define HEARD_POINTS 3
#define HEARD (2 + 2 * HEARD_POINTS)

/* A law of time that may jump or may not be finite: its name, its unit and that of its rate, and the constraint that
   it belongs to, -1 if it is always active. */
typedef struct {
    const char *what, *unit, *rate_unit;
    int row;
} Leap;

/* A limit of a stop: its name and its unit. */
typedef struct {
    const char *name, *unit;
} Limit;

/* A joint with dry friction: its row, which is in force while it sticks; places of its sticking displacement and of
   its sliding direction among the discrete states; whether its load is not unique. */
typedef struct {
    int row, value, slip, shared;
} Friction;

/* Nonzeros of a matrix, by columns. */
typedef struct {
    int rows, columns, entries;
    const int *offsets, *indices;
} Pattern;

/* An entry of the interface Jacobian: an output at the end of a communication step by an input that is held over it,
   which is one of so many directions. */
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
    Compiled *compiled; /* compiled code that replaces it, or NULL */
} Function;

/* Calls of functions on the memory of an instance, choices, loops. */
typedef struct {
    const int32_t *code;
    size_t words;
} Program;

/* The content of a scene file, written by alfmu/kernel/tables.py. Numbers name functions and programs, or are places
   in the memory or the workspace (-1: none). */
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
    const double *nominals; /* of first-order states */
    const int *angle_starts; /* start value that each computed angle begins near, -1 for none */
    const int *tied;         /* start values that are kept */
    const int *peak_parts;   /* readings that each peak is the magnitude of, -1 for none */
    const int *break_levels; /* level of each function whose change of sign is a jump or a bend */
    const double *normal;    /* standard normal numbers, TRIES x n; zero for time */
    const double *readiness; /* how readily an assembly moves each coordinate: more where none guesses it */
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

/* CRC-32 of bytes that follow others; it begins with CHECK_BEGIN, and its complement is the check sum. */
#define CHECK_BEGIN 0xffffffffu

#define HEAD 64 /* bytes before the body */
#define DEEPEST 16 /* choices and loops within each other */
#define MOST_NUMBERS (1 << 28) /* in the memory or the registers of an instance */
#define MOST_UNKNOWNS 10000 /* of a dense system */
#define MOST_RESULTS (1 << 26) /* of all functions */

uint32_t scene_check_sum(uint32_t sum, const unsigned char *at, size_t count);

/* A scene from the bytes of its file; NULL, and why, where it is damaged. */
Scene *scene_load(const unsigned char *bytes, size_t size, char *why, size_t why_size);

/* Compiled functions in place of the interpreted ones, before there is an instance: all of them in their order, and the
   numbers that the hungriest needs as workspace; 0 where they were made for another scene. */
int scene_compiled(Scene *s, Compiled *const *functions, int count, int spare, const char *identity);

void scene_free(Scene *s);

#include "internal_end.h"

#endif
