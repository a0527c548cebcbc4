#include "side_by_side.h"

#include <limits.h>
#include <string.h>

#include "interpret.h"
#include "operations.h"
#include "scene.h"

#if defined(__GNUC__)

/* Fewer interpreted calls than these are faster one after the other. */
#define FEW 3

/* Return the fewest calls of a function that run in lanes. */
static int fewest(const Function *f)
{
    if (f->in_lanes || f->compiled)
        return f->in_lanes ? 2 : INT_MAX;
    return f->narrow ? FEW : INT_MAX;
}

/* Calls of a function in lanes: places of their arguments and results in the memories of instances, or addresses. */
typedef struct {
    int count;
    double *m[LANES];
    const Word *places[LANES];
    const double *const *x[LANES]; /* addresses */
    double *const *y[LANES];
} Calls;

static inline double *number(const Calls *c, const Function *f, int at_places, int lane, int j)
{
    if (at_places)
        return c->m[lane] + c->places[lane][j];
    return j < f->inputs ? (double *)c->x[lane][j] : c->y[lane][j - f->inputs];
}

/* Copy argument j of calls to rows of `lanes` numbers; lanes in excess repeat a call. */
static inline void gather(const Calls *c, const Function *f, int at_places, int j, double *rows, int lanes)
{
    double *numbers[LANES];
    for (int lane = 0; lane < lanes; lane++)
        numbers[lane] = number(c, f, at_places, lane < c->count ? lane : 0, j);
    lanes_gather(rows, lanes, (const double *const *)numbers, f->lengths[j]);
}

/* Copy rows, or those in `from`, to result j of calls. */
static inline void scatter(
    const Calls *c, const Function *f, int at_places, int j, const double *rows, int lanes, const uint16_t *from)
{
    double *numbers[LANES];
    for (int lane = 0; lane < c->count; lane++)
        numbers[lane] = number(c, f, at_places, lane, j);
    lanes_scatter(rows, lanes, from, numbers, f->lengths[j], c->count);
}

static inline void interpret(const Group *g, const Calls *c, const Function *f, int at_places)
{
    Lanes *d = g->registers + g->instances[0]->scene->constant_count;
    const uint16_t *from = f->narrow + f->words;
    for (int j = 0; j < f->inputs; d += f->lengths[j++])
        gather(c, f, at_places, j, d->lane, LANES);
    lanes_evaluate(f, g->registers);
    for (int j = f->inputs; j < f->inputs + f->outputs; from += f->lengths[j++])
        scatter(c, f, at_places, j, g->registers->lane, LANES, from);
}

static inline void run_compiled(const Group *g, const Calls *c, const Function *f, int at_places)
{
    const int lanes = lanes_compiled();
    const double *x[MOST_ARGUMENTS];
    double *y[MOST_ARGUMENTS], *rows = g->registers->lane;
    for (int j = 0; j < f->inputs; rows += f->lengths[j++] * lanes) {
        gather(c, f, at_places, j, rows, lanes);
        x[j] = rows;
    }
    for (int j = 0; j < f->outputs; rows += f->lengths[f->inputs + j++] * lanes)
        y[j] = rows;
    f->in_lanes(x, y, rows);
    for (int j = 0; j < f->outputs; j++)
        scatter(c, f, at_places, f->inputs + j, y[j], lanes, NULL);
}

static inline void evaluate(const Group *g, const Calls *c, const Function *f, int at_places)
{
    if (f->in_lanes)
        run_compiled(g, c, f, at_places);
    else
        interpret(g, c, f, at_places);
}

static int lanes_of(const Function *f)
{
    return f->in_lanes ? lanes_compiled() : LANES;
}

#endif

/* Make `count` calls for each instance. */
static void call(const Group *g, const Function *f, const Word *at, int count)
{
    const int each = f->inputs + f->outputs;
    int member = 0, k = 0;
#if defined(__GNUC__)
    const int few = fewest(f), lanes = lanes_of(f);
    Calls c;
    for (int left = g->count * count; left >= few; left -= c.count) {
        for (c.count = 0; c.count < lanes && member < g->count; c.count++) {
            c.m[c.count] = g->instances[member]->m;
            c.places[c.count] = at + k * each;
            k = k + 1 < count ? k + 1 : 0;
            member += !k;
        }
        evaluate(g, &c, f, 1);
    }
#endif
    for (; member < g->count; member++, k = 0)
        for (; k < count; k++) {
            Instance *i = g->instances[member];
            function_call_at(i, i->scene->functions + (f - g->functions), at + k * each);
        }
}

void group_call_function(const Group *g, int function, const double *const **x, double *const **y)
{
    int member = 0;
#if defined(__GNUC__)
    const Function *f = g->functions + function;
    const int few = fewest(f), lanes = lanes_of(f);
    Calls c;
    for (; g->count - member >= few; member += c.count) {
        c.count = g->count - member < lanes ? g->count - member : lanes;
        memcpy(c.x, x + member, (size_t)c.count * sizeof *x);
        memcpy(c.y, y + member, (size_t)c.count * sizeof *y);
        evaluate(g, &c, f, 0);
    }
#endif
    for (; member < g->count; member++)
        function_call_alone(g->instances[member], function, x[member], y[member]);
}

/* Return the instances whose value of `number` is zero, or those for which it is not. */
static Group those(const Group *g, Word number, int zero)
{
    Group some;
    some.count = 0;
    some.registers = g->registers;
    some.functions = g->functions;
    for (int lane = 0; lane < g->count; lane++)
        if ((g->instances[lane]->m[number] == 0.0) == zero)
            some.instances[some.count++] = g->instances[lane];
    return some;
}

static void run(const Group *g, const Word *at, const Word *end);

static void loop(const Group *g, const Word *at)
{
    const Word *body = at + 3;
    Group on = *g;
    for (int times = 0; on.count; times++) {
        const Group before = on;
        on.count = 0;
        for (int lane = 0; lane < before.count; lane++) {
            Instance *i = before.instances[lane];
            if (loop_goes_on(i, at, times))
                on.instances[on.count++] = i;
        }
        if (on.count)
            run(&on, body, body + at[2]);
    }
}

static void run(const Group *g, const Word *at, const Word *end)
{
    while (at < end)
        switch (*at) {
        case CALL_CODE: {
            const Function *f = g->functions + at[1];
            call(g, f, at + 2, 1);
            at += 2 + f->inputs + f->outputs;
            break;
        }
        case LANES_CODE: {
            const Function *f = g->functions + at[2];
            call(g, f, at + 3, at[1]);
            at += 3 + at[1] * (f->inputs + f->outputs);
            break;
        }
        case CHOICE_CODE: {
            const Word *ways = at + 4;
            const Group one = those(g, at[1], 0), other = those(g, at[1], 1);
            if (one.count)
                run(&one, ways, ways + at[2]);
            if (other.count)
                run(&other, ways + at[2], ways + at[2] + at[3]);
            at = ways + at[2] + at[3];
            break;
        }
        case LOOP_CODE:
            loop(g, at + 1);
            at += 4 + at[3];
            break;
        default: {
            const Word *next = at;
            for (int lane = 0; lane < g->count; lane++)
                next = routine_run(g->instances[lane], at);
            at = next;
        }
        }
}

void group_run_program(const Group *g, int program)
{
    const Program *p = g->instances[0]->scene->programs + program;
    run(g, p->code, p->code + p->words);
}
