/* A scene: the equations of a mechanism as functions and programs, its variables and its sizes, as a scene file holds
   them. Brackets after a pointer give the number of its values; alfmu/fmi/constants.py reads them. */

#pragma once

#include "layout.h"
#include "linear.h"

/* Compiled code of a function: arguments, results, workspace. */
typedef void Compiled(const double *const *x, double *const *y, double *w);

typedef enum { REAL, INTEGER, BOOLEAN, STRING } Type;
typedef enum { PARAMETER, CHOICE, INPUT, SWITCH, OUTPUT } Kind;

typedef struct {
    const char *name, *unit;
    Type type;
    Kind kind;
    double start, minimum, maximum;
    int instant; /* whether an output depends on inputs without delay */
} Variable;

/* A text variable and its possible values. */
typedef struct {
    int count, start;
    const char *const *values; /* [count] */
} Choice;

typedef struct {
    const char *name, *direction, *unit;
    double size; /* value per unit of displacement; 0: determined from the coefficients */
} Row;

typedef struct {
    const char *name, *unit;
} Coordinate;

/* A Boolean input and the rows that it switches. */
typedef struct {
    int count;
    const int *rows; /* [count] */
    int holds, value, start;
} Switch;

/* A driving input, and how it is extrapolated within a communication step. */
typedef struct {
    int input, derivatives, order;
    double jump;
} Followed;

/* History of a driving input: number of points, order of their derivative, their times and values. */
#define HEARD_POINTS 3
#define HEARD (2 + 2 * HEARD_POINTS)

/* A law of time that may jump or may not be finite: its name, its unit, the unit of its rate, and its constraint (-1:
   always active). */
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
    const int *offsets; /* [columns + 1] */
    const int *indices; /* [entries] */
} Pattern;

/* An entry of the interface Jacobian: the derivative of an output at the end of a communication step by an input held
   over it; `direction` is the number of that input among those in the Jacobian. */
typedef struct {
    int output, input, direction;
} Jacobian_entry;

/* A place in the memory of an instance, or a length there. */
#ifndef WORD
#define WORD int32_t
#endif
typedef WORD Word;

/* A function: runs of equal operations, whose operands are places among constants, arguments and earlier results,
   followed by the places of its results. Places have 16 bits (narrow) or 32 (wide); a run of a narrow function also
   has the place of its first result. */
typedef struct {
    Word inputs, outputs, results, base;
    const Word *lengths;    /* [inputs + outputs] of arguments, then of results */
    const uint16_t *narrow; /* [words + results] */
    const int32_t *wide;    /* [words + results] */
    const uint8_t *brief;   /* [words + results] the same for sources, relative to `base` */
    unsigned words;
    int registers; /* numbers in its registers, constants included */
    Compiled *compiled; /* compiled code that replaces it, or NULL */
    Compiled *in_lanes; /* the same for a row of `lanes_compiled` instances in place of each number, or NULL */
} Function;

/* A program: calls of functions on the memory of an instance, choices and loops, as places and lengths. */
typedef struct {
    const Word *code; /* [words] */
    size_t words;
} Program;

/* The content of a scene file, written by alfmu/kernel/tables.py. Numbers name functions and programs, or are places
   in the memory or the workspace (-1: none). */
typedef struct {
    const char *name;
    char guid[40];
    unsigned body; /* check sum of the file without its head, as written in machine code */
#define NUMBER(name) int name;
    SCENE_NUMBERS(NUMBER)
#undef NUMBER
#define NUMBER(name) double name;
    SCENE_REALS(NUMBER)
#undef NUMBER
    /* Variables in the order of their references: parameters, choices, inputs, switches, outputs. The first parameters
       are those of the mechanism, then start values, start rates, compliances, states at the start, the solver's. */
    const Variable *variables; /* [parameters + choices + inputs + switches + outputs + entries] */
    const Choice *choice;      /* [choices] */
    const Switch *switched;    /* [switches] */
    const Friction *friction;  /* [frictions] */
    const int *impulse_rows;   /* [impulses] */
    const int *event_places;   /* [event_count] */
    const Coordinate *coordinates; /* [n] */
    const Row *rows;         /* [l] */
    const double *nominals;  /* of first-order states */
    const int *angle_starts; /* [angles] start value near which each computed angle begins, -1 for none */
    const int *tied;         /* [ties] start values that the assembly keeps */
    const int *peak_parts;   /* [3 * peaks] readings that each peak is the magnitude of, -1 for none */
    const int *break_levels; /* [break_count] level of each function whose change of sign is a jump or a kink */
    const double *normal;    /* [TRIES * n] standard normal numbers; zero for time */
    const double *readiness; /* [n] weight of each coordinate in an assembly: larger if it has no guess */
    int timed;               /* whether time is the last coordinate */
    int followed_count;
    const Followed *followed; /* [followed_count] */
    int leap_count;
    int limit_count;
    const Limit *limited; /* [limit_count] */
    const Leap *leaps;    /* [leap_count] */
    int entries, directions; /* of the interface Jacobian; its entries are the last variables */
    const Jacobian_entry *jacobian; /* [entries] */
    Pattern mass, constraint, gaps, tie_rows;
    Envelope closing; /* J J' of the start: J is C or the rows of the gaps, then those of the kept start values */
    Envelope holding; /* M + C' C */
    const double *constants;   /* [constant_count] */
    const Function *functions; /* [function_count] */
    const Program *programs;   /* [program_count] */
    int constant_count, function_count, program_count;
    int registers; /* most registers of a function, constants included */
    int lane_registers; /* registers of functions called in lanes */
    int spare;     /* workspace of compiled functions */
    int lane_rows; /* largest number of rows that a function compiled in lanes needs */
    int dense;     /* unknowns of the largest dense system */
    struct Block *blocks;
} Scene;

/* Continue a CRC-32 by more bytes: it begins with CHECK_BEGIN, and its complement is the check sum. */
#define CHECK_BEGIN 0xffffffffu

#define HEAD 64 /* bytes before the body */
#define DEEPEST 16 /* nesting of choices and loops */
#define MOST_NUMBERS (1 << 28) /* in the memory or the registers of an instance */
#define MOST_UNKNOWNS 10000 /* of a dense system */
#define MOST_RESULTS (1 << 26) /* of all functions */

uint32_t scene_check_sum(uint32_t sum, const unsigned char *at, size_t count);

/* Load a scene from the bytes of its file; return NULL and write the reason to `why` if it is damaged. */
Scene *scene_load(const unsigned char *bytes, size_t size, char *why, size_t why_size);

/* Replace the interpreted functions by compiled ones, or by ones in lanes, before there is an instance; `spare` is the
   largest workspace. Return 0 if they were made for another scene. */
int scene_compiled(Scene *s, Compiled *const *functions, int count, int spare, const char *identity, int in_lanes);

void scene_free(Scene *s);
