#include "side_by_side.h"

#include <stddef.h>
#include <stdint.h>

#include "interpret.h"
#include "operations.h"
#include "scene.h"

/* Fewer calls than these are faster one after the other. */
#define FEW 3

/* Return whether these calls of a function can and should run in lanes. */
static int serves(const Group *g, const Function *f)
{
#if defined(__GNUC__)
    return g->count >= FEW && f->narrow && !f->compiled;
#else
    return 0;
#endif
}

typedef struct {
    const double *x;
    double *y;
} Argument;

/* Evaluate a function in all lanes; `place` finds arguments and results by lane and index. */
static inline void evaluate(const Group *g, const Function *f, const void *places,
    Argument place(const Group *g, const Function *f, const void *places, int lane, int each))
{
    Lanes *d = g->registers + g->instances[0]->scene->constant_count;
    const uint16_t *from = f->narrow + f->words;
    for (int j = 0; j < f->inputs; d += f->lengths[j++])
        for (int lane = 0; lane < g->count; lane++) {
            const double *x = place(g, f, places, lane, j).x;
            for (int e = 0; e < f->lengths[j]; e++)
                d[e].lane[lane] = x[e];
        }
#if defined(__GNUC__)
    lanes_evaluate(f, g->registers);
#endif
    for (int j = f->inputs; j < f->inputs + f->outputs; from += f->lengths[j++])
        for (int lane = 0; lane < g->count; lane++) {
            double *y = place(g, f, places, lane, j).y;
            for (int e = 0; e < f->lengths[j]; e++)
                y[e] = g->registers[from[e]].lane[lane];
        }
}

static inline Argument in_memory(const Group *g, const Function *f, const void *places, int lane, int each)
{
    double *m = g->instances[lane]->m + ((const Word *)places)[each];
    const Argument place = {m, m};
    (void)f;
    return place;
}

static inline Argument in_arrays(const Group *g, const Function *f, const void *places, int lane, int each)
{
    Argument place = {NULL, NULL};
    (void)places;
    if (each < f->inputs)
        place.x = g->x[lane][each];
    else
        place.y = g->y[lane][each - f->inputs];
    return place;
}

static void call(const Group *g, const Function *f, const Word *at)
{
    if (serves(g, f))
        evaluate(g, f, at, in_memory);
    else
        for (int lane = 0; lane < g->count; lane++)
            function_call_at(g->instances[lane], f, at);
}

void group_call_function(const Group *g, int function)
{
    const Function *f = g->instances[0]->scene->functions + function;
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
            const Function *f = g->instances[0]->scene->functions + at[1];
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
