/* Runs with derivatives, for a binding: tangents of the requested values at each communication point, and adjoints of a
   weighted sum of all of them.

   A run for a backward sweep is divided into windows. The tape of the last window is kept; of the others, the state at
   their start, from which they are repeated, to the same bits, when the sweep reaches them. So memory is bounded, at
   the cost of at most two runs and a sweep. */

#include <stdlib.h>
#include <time.h>

#include "adjoint.h"
#include "begin.h"
#include "diagnosis.h"
#include "fmi.h"
#include "gradient.h"
#include "instance.h"
#include "lanes.h"
#include "outputs.h"
#include "record.h"
#include "run.h"
#include "scene.h"
#include "state.h"
#include "tangent.h"
#include "variables.h"
#include "whole_run.h"

#define NO_MEMORY (-2) /* outcome besides those of an instance; -1: the caller ended the run */

API Gradient *alfmu_gradient_new(Instance *i, int directions)
{
    return gradient_new(i, directions);
}

API void alfmu_gradient_free(Gradient *g)
{
    gradient_free(g);
}

static int set_row(Instance *i, const Run *r, long row)
{
    const Mark before = tape_mark(i), reading = i->tape->reading;
    Outcome outcome = DONE;
    for (int k = 0; k < r->input_count && outcome == DONE; k++)
        outcome = instance_set(i, r->inputs[k], r->table[row * r->input_count + k]);
    /* If inputs differ, drop the recorded reading at the end of the step, which is then repeated. */
    if (row && reading.entries && !i->flags.known && i->tape->used.entries == before.entries)
        tape_cut(i, reading);
    return (int)outcome;
}

static int step_to(Instance *i, const Run *r, long row)
{
    i->tape->reading = (Mark){0, 0, 0};
    return row ? (int)instance_step(i, r->times[row - 1], r->times[row] - r->times[row - 1]) : DONE;
}

static int read_row(Instance *i, const Run *r, long row)
{
    Outcome outcome = DONE;
    if (!row)
        outcome = diagnose_derivatives(i);
    if (!row && outcome == DONE)
        outcome = instance_initialize(i);
    i->flags.phase = i->flags.initialized ? STEPPING : INITIALIZING;
    if (outcome == DONE)
        outcome = instance_read(i);
    if (outcome == DONE && r->values)
        instance_get_many(i, r->wanted, r->wanted_count, r->values + row * r->wanted_count);
    return (int)outcome;
}

/* Ask the caller a few times a second; return zero to end the run. */
static int goes_on(const Run *r, long row, clock_t *asked)
{
    if (!r->progress || clock() - *asked <= CLOCKS_PER_SEC / 20)
        return 1;
    *asked = clock();
    return r->progress(row);
}

/* Make a run with tangents. `seeds` holds the directions (directions) of each parameter, `input_seeds` those of each
   input at each row (NULL for none); `derivatives` becomes (rows, wanted, directions). Return the number of rows. */
API long alfmu_tangent_run(Gradient *g, const Run *r, int directions, const double *seeds, const double *input_seeds,
    double *derivatives, int *outcome)
{
    Instance *i = g->instance;
    const Scene *s = i->scene;
    const Mark begin = {0, 0, 0};
    clock_t asked = clock();
    long row = 0;
    *outcome = DONE;
    memset(g->tangents, 0, (size_t)g->blocks * g->places * sizeof *g->tangents);
    for (int k = 0; k < s->parameters; k++)
        for (int d = 0; d < directions; d++)
            g->tangents[(size_t)(d / LANES) * g->places + (size_t)tape_place_of(i, i->values + k)].lane[d % LANES] =
                seeds[k * directions + d];
    i->tape = g->tape;
    while (row < r->count && *outcome == DONE) {
        if (!goes_on(r, row, &asked)) {
            *outcome = -1;
            break;
        }
        tape_clear(g->tape);
        *outcome = step_to(i, r, row);
        if (*outcome == DONE)
            *outcome = set_row(i, r, row);
        tangents_along(g, begin);
        for (int k = 0; input_seeds && k < r->input_count; k++)
            for (int d = 0; d < directions; d++)
                g->tangents[(size_t)(d / LANES) * g->places + (size_t)tape_place_of(i, instance_place(i, r->inputs[k]))]
                    .lane[d % LANES] = input_seeds[(row * r->input_count + k) * directions + d];
        tape_clear(g->tape);
        if (*outcome == DONE)
            *outcome = read_row(i, r, row);
        tangents_along(g, begin);
        if (*outcome == DONE && (g->lost || g->tape->lost))
            *outcome = NO_MEMORY;
        for (int k = 0; *outcome == DONE && k < r->wanted_count; k++) {
            const double *value = instance_place(i, r->wanted[k]);
            const int32_t place = value ? tape_place_of(i, value) : -1;
            for (int d = 0; d < directions; d++)
                derivatives[(row * r->wanted_count + k) * directions + d] =
                    place < 0 ? 0.0 : g->tangents[(size_t)(d / LANES) * g->places + (size_t)place].lane[d % LANES];
        }
        row += *outcome == DONE;
    }
    i->tape = NULL;
    return row;
}

/* Make rows up to `end`, or until the tape takes `bytes`, with the marks of each; return the outcome. */
static int make_rows(Gradient *g, const Run *r, long *row, long end, size_t bytes, clock_t *asked)
{
    Instance *i = g->instance;
    const long first = *row;
    int outcome = DONE;
    tape_clear(g->tape);
    i->onward = 0; /* Reuse no evaluation from before. */
    while (*row < end && outcome == DONE && (*row == first || tape_bytes(g->tape) <= bytes)) {
        if (!goes_on(r, *row, asked))
            return -1;
        outcome = step_to(i, r, *row);
        if (outcome == DONE)
            outcome = set_row(i, r, *row);
        g->marks[2 * (*row - first)] = tape_mark(i);
        if (outcome == DONE)
            outcome = read_row(i, r, *row);
        g->marks[2 * (*row - first) + 1] = tape_mark(i);
        if (outcome == DONE && (g->lost || g->tape->lost))
            outcome = NO_MEMORY;
        *row += outcome == DONE;
    }
    return outcome;
}

/* Make a run for a backward sweep, with a tape of about so many bytes; return the number of rows. */
API long alfmu_recorded_run(Gradient *g, const Run *r, double bytes, int *outcome)
{
    Instance *i = g->instance;
    const size_t size = state_size(i);
    clock_t asked = clock();
    long row = 0;
    *outcome = DONE;
    free(g->marks);
    g->marks = malloc(2 * (size_t)r->count * sizeof *g->marks);
    g->window_count = g->swept = 0;
    if (!g->marks)
        *outcome = NO_MEMORY;
    i->tape = g->tape;
    while (row < r->count && *outcome == DONE) {
        if (g->window_count == g->window_room) {
            const long room = g->window_room ? 2 * g->window_room : 8;
            unsigned char *states = realloc(g->states, (size_t)room * size);
            long *windows = realloc(g->windows, (size_t)room * sizeof *windows);
            g->states = states ? states : g->states;
            g->windows = windows ? windows : g->windows;
            if (!states || !windows) {
                *outcome = NO_MEMORY;
                break;
            }
            g->window_room = room;
        }
        state_save(i, g->states + (size_t)g->window_count * size);
        g->windows[g->window_count++] = row;
        *outcome = make_rows(g, r, &row, r->count, (size_t)bytes, &asked);
    }
    i->tape = NULL;
    g->rows = *outcome == DONE ? row : 0;
    return row;
}

/* Sweep back the rows of the window on the tape. */
static void sweep_rows(Gradient *g, const Run *r, long first, long end, const double *weights, double *of_inputs)
{
    const Instance *i = g->instance;
    const Mark begin = {0, 0, 0};
    Mark used = g->tape->used;
    for (long row = end; row-- > first;) {
        const Mark set = g->marks[2 * (row - first)], before = row > first ? g->marks[2 * (row - first) - 1] : begin;
        for (int k = 0; k < r->wanted_count; k++) {
            const double *value = instance_place(i, r->wanted[k]);
            const int32_t place = value ? tape_place_of(i, value) : -1;
            if (place >= 0)
                g->adjoints[place] += weights[row * r->wanted_count + k];
        }
        adjoints_along(g, set);
        g->tape->used = set;
        for (int k = 0; k < r->input_count; k++) {
            const int32_t place = tape_place_of(i, instance_place(i, r->inputs[k]));
            of_inputs[row * r->input_count + k] = g->adjoints[place];
            g->adjoints[place] = 0.0;
        }
        adjoints_along(g, before);
        g->tape->used = before;
    }
    g->tape->used = used;
}

/* Differentiate the sum of all values of a recorded run times `weights` (rows, wanted): with respect to each parameter,
   and to each input at each row. The run can be swept again with other weights. */
API int alfmu_adjoint_run(Gradient *g, const Run *r, const double *weights, double *of_parameters, double *of_inputs)
{
    Instance *i = g->instance;
    const size_t size = state_size(i), workspace = (size_t)(i->workspace - i->numbers);
    clock_t asked = clock();
    Run again = *r;
    int outcome = DONE;
    unsigned char *end = malloc(size);
    if (!end || !g->rows) {
        free(end);
        return NO_MEMORY;
    }
    state_save(i, end);
    again.values = NULL;
    memset(g->adjoints, 0, g->places * sizeof *g->adjoints);
    for (long w = g->window_count; w-- && outcome == DONE;) {
        const long first = g->windows[w], last = w + 1 < g->window_count ? g->windows[w + 1] : g->rows;
        long row = first;
        if (g->window_count > 1) {
            if (w + 1 < g->window_count || g->swept) {
                i->tape = NULL;
                outcome = (int)state_restore(i, g->states + (size_t)w * size, size);
                i->tape = g->tape;
                if (outcome == DONE)
                    outcome = make_rows(g, &again, &row, last, (size_t)-1, &asked);
                i->tape = NULL;
            }
        }
        if (outcome == DONE)
            sweep_rows(g, r, first, last, weights, of_inputs);
        /* Windows depend on each other only through the memory of the instance. */
        memset(g->adjoints + workspace, 0, (g->places - workspace) * sizeof *g->adjoints);
    }
    g->swept = g->window_count > 1;
    state_restore(i, end, size);
    free(end);
    memcpy(
        of_parameters, g->adjoints + tape_place_of(i, i->values), (size_t)i->scene->parameters * sizeof *of_parameters);
    return g->lost ? NO_MEMORY : outcome;
}
