/* Lets results within a function share places: for memory that is scarce (`alfmu.fmi.source`, which also leaves out
   constants that no function reads), and for lanes, whose registers then stay in the cache nearest to the processor. */

#include "share.h"

#include "arrange_operations.h"
#include "fmi.h"
#include "operations.h"
#include "scene.h"

#define UNREAD (-1)
#define RESULT INT32_MAX

/* A function whose results have a place each, in order, and the places that they share. */
typedef struct {
    Room room;
    const Function *f;
    uint16_t *code; /* [f->words + f->results] */
    int constants;  /* how many constants there are, which come first, and how many of them are kept */
    int kept;
    int *last;      /* last run that reads a place: UNREAD, or RESULT if it is read after all runs */
    int *shared;    /* shared place of each place */
    int *taken;     /* whether a shared place is read by a later run */
} Sharing;

static void find_last_reads(Sharing *s)
{
    int run = 0;
    for (size_t at = 0; at < s->f->words; run++) {
        const size_t end = at + NARROW_HEAD + (size_t)(s->code[at + 1] * OPERANDS[s->code[at]]);
        for (at += NARROW_HEAD; at < end; at++)
            s->last[s->code[at]] = run;
    }
    for (size_t k = 0; k < (size_t)s->f->results; k++)
        s->last[s->code[s->f->words + k]] = RESULT;
}

/* Take the first free places for `count` results in a row; return the first of them. */
static int take(Sharing *s, int count)
{
    int at = s->kept, found = 0;
    while (found < count)
        found = s->taken[at++] ? 0 : found + 1;
    for (int k = 1; k <= count; k++)
        s->taken[at - k] = 1;
    return at - count;
}

/* Replace the places in the code, of which `first` precede the results; return how many there are then. The results of
   a run take no place that the run reads, as it may read its own results. */
static int replace(Sharing *s, int first)
{
    int places = first, run = 0;
    for (size_t at = 0; at < s->f->words; run++) {
        const int count = s->code[at + 1], results = count * VALUES_OF(s->code[at]), own = s->code[at + 2];
        const int to = take(s, results);
        const size_t end = at + NARROW_HEAD + (size_t)(count * OPERANDS[s->code[at]]);
        s->code[at + 2] = (uint16_t)to;
        places = to + results > places ? to + results : places;
        for (int k = 0; k < results; k++) {
            s->shared[own + k] = to + k;
            s->taken[to + k] = s->last[own + k] != UNREAD;
        }
        for (at += NARROW_HEAD; at < end; at++) {
            const int place = s->code[at];
            s->code[at] = (uint16_t)s->shared[place];
            if (s->last[place] == run && place >= s->constants)
                s->taken[s->shared[place]] = 0;
        }
    }
    for (size_t k = s->f->words; k < s->f->words + (size_t)s->f->results; k++)
        s->code[k] = (uint16_t)s->shared[s->code[k]];
    return places;
}

/* Number the constants that functions with 16-bit places read, and move them to the front; return their number. All are
   kept if a function has 32-bit places. */
static int keep_constants(Scene *scene, int *numbers)
{
    double *constants = (double *)scene->constants;
    int kept = 0, all = 0;
    for (int which = 0; which < scene->function_count; which++) {
        const Function *f = scene->functions + which;
        const uint16_t *code = f->narrow, *end = code + f->words;
        all = all || (!code && f->words);
        for (; code && code < end; code += NARROW_HEAD + code[1] * OPERANDS[code[0]])
            for (int k = 0; k < code[1] * OPERANDS[code[0]]; k++)
                numbers[code[NARROW_HEAD + k]] = 1;
        for (size_t k = 0; code && k < (size_t)f->results; k++)
            numbers[end[k]] = 1;
    }
    for (int k = 0; k < scene->constant_count; k++)
        if (all || numbers[k]) {
            constants[kept] = constants[k];
            numbers[k] = kept++;
        }
    return kept;
}

/* Let the results within a function share places in its code. `numbers` are the new places of the constants, `kept` of
   which remain. Return whether there is memory for this. */
static int share(Function *f, uint16_t *code, int constants, const int *numbers, int kept)
{
    Sharing s = {{0}, f, code, constants, kept, NULL, NULL, NULL};
    const size_t size = (size_t)f->registers + 1;
    int arguments = 0;
    for (int k = 0; k < f->inputs; k++)
        arguments += f->lengths[k];
    s.last = arrange_integers(&s.room, size, UNREAD);
    s.shared = arrange_integers(&s.room, size, 0);
    s.taken = arrange_integers(&s.room, size, 0);
    if (!s.room.missing) {
        find_last_reads(&s);
        for (int k = 0; k < constants; k++)
            s.shared[k] = numbers ? numbers[k] : k;
        for (int k = 0; k < kept; k++)
            s.taken[k] = 1;
        for (int k = 0; k < arguments; k++) {
            s.shared[constants + k] = kept + k;
            s.taken[kept + k] = s.last[constants + k] != UNREAD;
        }
        f->registers = replace(&s, kept + arguments);
        f->narrow = code;
    }
    arrange_leave(&s.room);
    return !s.room.missing;
}

int share_in_copy(Function *f, uint16_t *code, int constants)
{
    memcpy(code, f->narrow, (f->words + (size_t)f->results) * sizeof *code);
    return share(f, code, constants, NULL, constants);
}

/* Let the results within each function of a scene share places. Derivatives of the scene are no longer valid. Return
   -1 without memory. */
API int alfmu_share_places(Scene *scene)
{
    Room room = {0};
    int *numbers = arrange_integers(&room, UINT16_MAX + 1, 0), done = !room.missing, kept = 0;
    if (done)
        kept = keep_constants(scene, numbers);
    for (int which = 0; which < scene->function_count && done; which++) {
        Function *f = (Function *)scene->functions + which;
        if (f->narrow)
            done = share(f, (uint16_t *)f->narrow, scene->constant_count, numbers, kept);
    }
    arrange_leave(&room);
    if (done)
        scene->constant_count = kept;
    return done ? 0 : -1;
}
