#include "side_by_side.h"

#include "baseline.h"
#include "interpret.h"
#include "operations.h"
#include "scene.h"

#if defined(__GNUC__)

/* Fewer interpreted calls than these are faster one after the other. */
#define FEW 3

/* Return whether these calls of a function can and should run in lanes. */
static int serves(const Group *g, const Function *f)
{
    if (f->in_lanes || f->compiled)
        return f->in_lanes && g->count > 1;
    return f->narrow && g->count >= FEW;
}

/* Finds an argument or a result of a call, by lane and number. */
typedef double *Place(const Group *g, const Function *f, const Word *places, int lane, int each);

/* Copy argument j of calls from `first` on to rows of `lanes` numbers; lanes in excess repeat a call. */
static inline void gather(const Group *g, const Function *f, const Word *places, Place place, int first, int j,
    double *rows, int lanes)
{
    double *numbers[LANES];
    for (int lane = 0; lane < lanes; lane++)
        numbers[lane] = place(g, f, places, first + lane < g->count ? first + lane : 0, j);
    lanes_gather(rows, lanes, (const double *const *)numbers, f->lengths[j]);
}

/* Copy rows, or those in `from`, to result j of these calls. */
static inline void scatter(const Group *g, const Function *f, const Word *places, Place place, int first, int j,
    const double *rows, int lanes, const uint16_t *from)
{
    const int count = g->count - first < lanes ? g->count - first : lanes;
    double *numbers[LANES];
    for (int lane = 0; lane < count; lane++)
        numbers[lane] = place(g, f, places, first + lane, j);
    lanes_scatter(rows, lanes, from, numbers, f->lengths[j], count);
}

static inline void interpret(const Group *g, const Function *f, const Word *places, Place place)
{
    Lanes *d = g->registers + g->instances[0]->scene->constant_count;
    const uint16_t *from = f->narrow + f->words;
    for (int j = 0; j < f->inputs; d += f->lengths[j++])
        gather(g, f, places, place, 0, j, d->lane, LANES);
    lanes_evaluate(f, g->registers);
    for (int j = f->inputs; j < f->inputs + f->outputs; from += f->lengths[j++])
        scatter(g, f, places, place, 0, j, g->registers->lane, LANES, from);
}

static inline void run_compiled(const Group *g, const Function *f, const Word *places, Place place)
{
    const int lanes = lanes_compiled();
    const double *x[MOST_ARGUMENTS];
    double *y[MOST_ARGUMENTS];
    for (int first = 0; first < g->count; first += lanes) {
        double *rows = g->registers->lane;
        for (int j = 0; j < f->inputs; rows += f->lengths[j++] * lanes) {
            gather(g, f, places, place, first, j, rows, lanes);
            x[j] = rows;
        }
        for (int j = 0; j < f->outputs; rows += f->lengths[f->inputs + j++] * lanes)
            y[j] = rows;
        f->in_lanes(x, y, rows);
        for (int j = 0; j < f->outputs; j++)
            scatter(g, f, places, place, first, f->inputs + j, y[j], lanes, NULL);
    }
}

static inline void evaluate(const Group *g, const Function *f, const Word *places, Place place)
{
    if (f->in_lanes)
        run_compiled(g, f, places, place);
    else
        interpret(g, f, places, place);
}

static inline double *in_memory(const Group *g, const Function *f, const Word *places, int lane, int each)
{
    (void)f;
    return g->instances[lane]->m + places[each];
}

/* Arguments are only read. */
static inline double *in_arrays(const Group *g, const Function *f, const Word *places, int lane, int each)
{
    (void)places;
    return each < f->inputs ? (double *)g->x[lane][each] : g->y[lane][each - f->inputs];
}

#else
#define serves(g, f) 0
#define evaluate(g, f, places, place) (void)0
#endif

static void call(const Group *g, const Function *f, const Word *at)
{
    if (serves(g, f))
        evaluate(g, f, at, in_memory);
    else
        for (int lane = 0; lane < g->count; lane++)
            function_call_at(g->instances[lane], g->instances[lane]->scene->functions + (f - g->functions), at);
}

void group_call_function(const Group *g, int function)
{
    const Function *f = g->functions + function;
    if (serves(g, f))
        evaluate(g, f, NULL, in_arrays);
    else
        for (int lane = 0; lane < g->count; lane++)
            function_call_alone(g->instances[lane], function, g->x[lane], g->y[lane]);
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

#if defined(__GNUC__)

/* Argument or result of one of several calls of an instance. */
static inline double *of_call(const Group *g, const Function *f, const Word *places, int lane, int each)
{
    return (*g->instances)->m + places[lane * (f->inputs + f->outputs) + each];
}

/* Run an instance's calls in lanes by a function compiled in lanes; return the next word. */
static const Word *run_lanes(const Group *g, int lane, const Word *at)
{
    const int count = at[1];
    const Function *f = g->functions + at[2];
    Group calls = {{g->instances[lane]}, {NULL}, {NULL}, 0, g->registers, g->functions};
    at += 3;
    for (int left = count; left > 0; left -= LANES, at += calls.count * (f->inputs + f->outputs)) {
        calls.count = left < LANES ? left : LANES;
        run_compiled(&calls, f, at, of_call);
    }
    return at;
}

#endif

static const Word *run_routine(const Group *g, int lane, const Word *at)
{
#if defined(__GNUC__)
    if (*at == LANES_CODE && g->functions[at[2]].in_lanes)
        return run_lanes(g, lane, at);
#endif
    return routine_run(g->instances[lane], at);
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
            call(g, f, at + 2);
            at += 2 + f->inputs + f->outputs;
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
                next = run_routine(g, lane, at);
            at = next;
        }
        }
}

void group_run_program(const Group *g, int program)
{
    const Program *p = g->instances[0]->scene->programs + program;
    run(g, p->code, p->code + p->words);
}
