/* Many instances of one scene, some of which are evaluated side by side. Each instance has a fiber, which waits before
   it runs a program or calls a function; members that wait for the same one run it together. */

#include <stdlib.h>

#include "begin.h"
#include "border.h"
#include "fibers.h"
#include "fmi.h"
#include "gradient.h"
#include "instance.h"
#include "interpret.h"
#include "lanes.h"
#include "lifetime.h"
#include "outputs.h"
#include "run.h"
#include "scene.h"
#include "share.h"
#include "side_by_side.h"
#include "variables.h"
#include "whole_run.h"

#define NOTHING (-1)

typedef struct Batch Batch;

/* Work on one member; returns its outcome. */
typedef Outcome Task(Batch *b, size_t member);

/* A running member, and the number of the program or function that it waits for; functions follow the programs. */
typedef struct {
    Batch *batch;
    Fiber *fiber; /* NULL on platforms without fibers, where members run one after the other */
    double *lent; /* work space that the member borrows */
    Instance *instance;
    int wanted;
    const double *const *x;
    double *const *y;
} Place;

struct Batch {
    const Scene *scene;
    size_t count, next; /* number of members, and the next one to run */
    int shares;         /* whether members borrow work space and wait; with a tape of derivatives they must not */
    Instance *members;
    double *numbers, *lent, *registers;
    Function *functions; /* the scene's; results of those in lanes share places in `code` */
    uint16_t *code;
    Place places[MEMBERS], *end; /* end of the places in use */
    Group group;
    int *waiting; /* [programs and functions] scratch: number of members that wait for each */
    /* The current task, and its arguments. */
    Task *task;
    const unsigned char *chosen; /* [count] whether the task is for this member; NULL for all members */
    int *outcomes;               /* [count] */
    double h;
    const double *values; /* [count, count of references] */
    double *found;
    const int *references;
    int reference_count;
    const Run *run;
    long *rows; /* [count] */
};

static void wait_at_place(Instance *i, int which, const double *const *x, double *const *y)
{
    Place *p = i->place;
    p->wanted = which + (x ? i->scene->program_count : 0);
    p->x = x;
    p->y = y;
    fiber_leave(p->fiber);
}

/* Run the task for one member after the other. */
static void work_at_place(void *what)
{
    Place *p = what;
    Batch *b = p->batch;
    while (b->next < b->count) {
        const size_t member = b->next++;
        Instance *i = p->instance = b->members + member;
        if (b->chosen && !b->chosen[member])
            continue;
        if (b->shares) {
            instance_borrow(i, p->lent, 1);
            i->place = p;
            i->wait = p->fiber ? wait_at_place : NULL;
        }
        b->outcomes[member] = (int)b->task(b, member);
        if (b->shares) {
            i->wait = NULL;
            instance_borrow(i, b->places->lent, 1);
        }
    }
    p->wanted = NOTHING;
}

/* Return the program or function for which most members wait, the first of them. */
static int wanted_most(const Batch *b)
{
    int most = 0, wanted = NOTHING;
    const Place *p = b->places, *q = p;
    for (; p < b->end; p++)
        if (p->wanted != NOTHING && ++b->waiting[p->wanted] > most) {
            most = b->waiting[p->wanted];
            wanted = p->wanted;
        }
    for (; q < p; q++)
        if (q->wanted != NOTHING)
            b->waiting[q->wanted] = 0;
    return wanted;
}

static void serve(Batch *b, int wanted)
{
    const int programs = b->scene->program_count;
    Place *those[MEMBERS];
    const double *const *x[MEMBERS];
    double *const *y[MEMBERS];
    Group *g = &b->group;
    g->count = 0;
    for (Place *p = b->places; p < b->end; p++)
        if (p->wanted == wanted) {
            g->instances[g->count] = p->instance;
            x[g->count] = p->x;
            y[g->count] = p->y;
            those[g->count++] = p;
        }
    if (wanted < programs)
        group_run_program(g, wanted);
    else
        group_call_function(g, wanted - programs, x, y);
    for (int k = 0; k < g->count; k++)
        fiber_enter(those[k]->fiber);
}

static void do_task(Batch *b, Task *task, const unsigned char *chosen, int *outcomes)
{
    const Border border = border_in();
    int wanted;
    b->task = task;
    b->chosen = chosen;
    b->outcomes = outcomes;
    b->next = 0;
    if (b->places->fiber) {
        for (Place *p = b->places; p < b->end; p++)
            fiber_enter(p->fiber);
        while ((wanted = wanted_most(b)) != NOTHING)
            serve(b, wanted);
    } else
        work_at_place(b->places);
    border_out(&border);
}

API void alfmu_batch_free(Batch *b)
{
    if (!b)
        return;
    for (Place *p = b->places; p < b->end; p++)
        fiber_free(p->fiber);
    for (size_t k = 0; b->members && k < b->count; k++)
        gradient_free(b->members[k].of_step);
    free(b->members);
    free(b->numbers);
    free(b->lent);
    free(b->registers);
    free(b->functions);
    free(b->code);
    free(b->waiting);
    free(b);
}

/* Return whether lanes interpret a function. */
static int is_interpreted(const Function *f)
{
    return f->narrow && !f->compiled && !f->in_lanes;
}

/* Make the functions for lanes; find the most registers. Return whether there is memory for this. */
static int has_functions(Batch *b, size_t *most)
{
    const Scene *s = b->scene;
    size_t words = 1;
    int done;
    for (int k = 0; k < s->function_count; k++)
        words += is_interpreted(s->functions + k) ? s->functions[k].words + (size_t)s->functions[k].results : 0;
    b->functions = malloc(((size_t)s->function_count + 1) * sizeof *b->functions);
    b->code = malloc(words * sizeof *b->code);
    done = b->functions && b->code;
    words = 0;
    *most = (size_t)s->constant_count;
    for (int k = 0; k < s->function_count && done; k++) {
        Function *f = b->functions + k;
        *f = s->functions[k];
        if (is_interpreted(f)) {
            done = share_in_copy(f, b->code + words, s->constant_count);
            words += f->words + (size_t)f->results;
            *most = (size_t)f->registers > *most ? (size_t)f->registers : *most;
        }
    }
    return done;
}

static int has_memory(Batch *b, size_t kept, size_t lent)
{
    const Scene *s = b->scene;
    size_t registers, numbers;
    if (!has_functions(b, &registers))
        return 0;
    numbers = LANES * (registers + 1 + (size_t)s->lane_rows);
    b->members = calloc(b->count, sizeof *b->members);
    b->numbers = calloc(b->count, kept * sizeof *b->numbers);
    b->lent = calloc((size_t)(b->end - b->places), lent * sizeof *b->lent);
    b->registers = malloc(numbers * sizeof *b->registers);
    b->waiting = calloc((size_t)(s->program_count + s->function_count), sizeof *b->waiting);
    return b->members && b->numbers && b->lent && b->registers && b->waiting;
}

/* Begin the fibers of all places; if one of them cannot be made, use none. */
static void begin_fibers(Batch *b)
{
    int all = 1;
    for (Place *p = b->places; p < b->end; p++)
        all &= (p->fiber = fiber_new(work_at_place, p)) != NULL;
    for (Place *p = b->places; !all && p < b->end; p++) {
        fiber_free(p->fiber);
        p->fiber = NULL;
    }
}

/* Return a batch of `count` members; NULL without memory for them. */
API Batch *alfmu_batch_new(const Scene *s, size_t count)
{
    const size_t lent = instance_lent_length(s, 1), kept = instance_kept_length(s) + (s->entries ? lent : 0);
    Batch *b = calloc(1, sizeof *b);
    if (!b)
        return NULL;
    b->scene = s;
    b->count = count;
    b->shares = !s->entries;
    b->end = b->places + (count < MEMBERS ? count : MEMBERS);
    if (!has_memory(b, kept, lent)) {
        alfmu_batch_free(b);
        return NULL;
    }
    b->group.functions = b->functions;
    b->group.registers = (Lanes *)(void *)lanes_align(b->registers);
    for (int k = 0; k < LANES * s->constant_count; k++)
        b->group.registers[k / LANES].lane[k % LANES] = s->constants[k / LANES];
    for (int k = 0; k < b->end - b->places; k++) {
        b->places[k] = (Place){b, NULL, b->lent + (size_t)k * lent, NULL, NOTHING, NULL, NULL};
        instance_lay(b->members, s, b->numbers, b->places[k].lent, 1); /* loads the constants */
    }
    for (size_t k = 0; k < count; k++)
        instance_lay(b->members + k, s, b->numbers + k * kept, b->shares ? b->places->lent : NULL, 1);
    begin_fibers(b);
    return b;
}

/* Return a member, which serves for all calls of single instances except alfmu_free. */
API Instance *alfmu_batch_member(Batch *b, size_t member)
{
    return b->members + member;
}

static Outcome set(Batch *b, size_t member)
{
    const double *values = b->values + member * (size_t)b->reference_count;
    Outcome outcome = DONE;
    for (int k = 0; k < b->reference_count && outcome == DONE; k++)
        outcome = instance_set(b->members + member, b->references[k], values[k]);
    return outcome;
}

/* Set variables to values (members, count). */
API void alfmu_batch_set(
    Batch *b, const int *references, int count, const double *values, const unsigned char *chosen, int *outcomes)
{
    b->references = references;
    b->reference_count = count;
    b->values = values;
    do_task(b, set, chosen, outcomes);
}

static Outcome get(Batch *b, size_t member)
{
    double *found = b->found + member * (size_t)b->reference_count;
    return outputs_get_many(b->members + member, b->references, b->reference_count, found);
}

/* Get values (members, count) of variables; if outputs of a member cannot be computed, get the others. */
API void alfmu_batch_get(
    Batch *b, const int *references, int count, double *values, const unsigned char *chosen, int *outcomes)
{
    b->references = references;
    b->reference_count = count;
    b->found = values;
    do_task(b, get, chosen, outcomes);
}

static Outcome initialize(Batch *b, size_t member)
{
    Instance *i = b->members + member;
    const Outcome outcome = instance_initialize(i);
    if (outcome == DONE)
        i->flags.phase = STEPPING;
    return outcome;
}

API void alfmu_batch_initialize(Batch *b, const unsigned char *chosen, int *outcomes)
{
    do_task(b, initialize, chosen, outcomes);
}

static Outcome step(Batch *b, size_t member)
{
    Instance *i = b->members + member;
    return instance_step(i, *instance_time(i), b->h);
}

API void alfmu_batch_step(Batch *b, double h, const unsigned char *chosen, int *outcomes)
{
    b->h = h;
    do_task(b, step, chosen, outcomes);
}

static Outcome run(Batch *b, size_t member)
{
    Instance *i = b->members + member;
    Run own = *b->run;
    Outcome outcome = set(b, member);
    long done;
    b->rows[member] = 0;
    if (outcome != DONE)
        return outcome;
    own.values += member * (size_t)own.count * (size_t)own.wanted_count;
    *instance_time(i) = *own.times;
    b->rows[member] = whole_run_make(i, &own, &done, &outcome);
    return outcome;
}

/* Set variables of members that are not initialised, and make a run of each. `values` of the run are (members, rows,
   wanted); `rows` receives the number of rows of each member. */
API void alfmu_batch_run(Batch *b, const Run *asked, const int *references, int count, const double *values, long *rows,
    const unsigned char *chosen, int *outcomes)
{
    b->run = asked;
    b->references = references;
    b->reference_count = count;
    b->values = values;
    b->rows = rows;
    do_task(b, run, chosen, outcomes);
}
