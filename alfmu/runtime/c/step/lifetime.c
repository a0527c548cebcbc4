#include "lifetime.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "breaks.h"
#include "exchange.h"
#include "gradient.h"
#include "instance.h"
#include "interpret.h"
#include "jumps.h"
#include "lanes.h"
#include "layout.h"
#include "linear.h"
#include "peaks.h"
#include "scene.h"
#include "scene_sizes.h"

/* Set the pointers to the parts, one behind the other. Return the total size. */
static size_t layout_parts(Instance *i, double *numbers)
{
    const Scene *s = i->scene;
    size_t count = 0;
    const struct {
        double **part;
        int size;
    } parts[] = {
        {&i->values, s->parameters},
        {&i->requested, s->switches},
        {&i->active, s->switches},
        {&i->discrete, s->held},
        {&i->input_history, s->followed_count * HEARD},
        {&i->impulses, s->impulses},
        {&i->dissipated, 1},
        {&i->slopes, s->inputs + 1},
        {&i->penalty, s->l},
        {&i->full, s->l},
        {&i->units, s->l},
        {&i->scales, s->n},
        {&i->compliances, s->compliances},
        {&i->freedom, 1},
        {&i->masses, 1},
        {&i->regular, 1},
        {&i->rank, 1},
        {&i->largest_penalty, 1},
        {&i->length, 1},
        {&i->peaks, (int)scene_peaks_length(s)},
        {&i->jacobian, s->entries},
        {&i->exchange, scene_exchange_variables(s) + EXCHANGE_TIMES},
        {&i->given, s->l},
        {&i->counts, COUNTED},
        {&i->stabilisation, 2},
        {&i->projection, 1},
        {&i->m, s->size},
    };
    for (size_t k = 0; k < sizeof parts / sizeof *parts; k++) {
        if (numbers)
            *parts[k].part = numbers + count;
        count += (size_t)parts[k].size;
    }
    return count;
}

Instance *instance_new(const Scene *s)
{
    const size_t side = (size_t)(s->n + s->l + s->ties + 1);
    Instance *i = calloc(1, sizeof *i);
    double *numbers;
    if (!i)
        return NULL;
    i->scene = s;
    i->count = layout_parts(i, NULL);
    /* Matrices for singular values are dense; the others are sparse. */
    i->room = (s->n <= DENSE ? 12 * side * side : 0) + (size_t)64 * side + s->closing.entries + s->holding.entries
        + 16 * (size_t)(s->mass.entries + s->constraint.entries + s->gaps.entries + s->tie_rows.entries)
        + 4 * (size_t)(scene_driven(s) + s->outputs) + (size_t)(s->past + s->past_size - s->pace);
    i->room += laws_room(s) + breaks_room(s) + peaks_room(s) + (size_t)s->limit_count * (2 + (size_t)s->n);
    if (s->frictions) /* memory of steps up to events */
        i->room += (size_t)(18 * s->frictions + 2 * s->held + s->past + s->past_size - s->pace) + scene_state_length(s)
            + scene_peaks_length(s);
    /* The workspace of programs follows the memory, which is the last part of the numbers. */
    numbers = calloc(2 * i->count + (size_t)s->workspace + i->room + (size_t)s->registers
            + LANES * ((size_t)s->lane_registers + 1) + (size_t)s->spare + (size_t)s->past_size
            + (size_t)(s->held + s->followed_count * HEARD) + linear_least_norm_work(s->dense, s->dense)
            + 2 * (size_t)s->n + (size_t)s->inputs + (s->break_count ? 2 * MOST_BREAKS : 0),
        sizeof *numbers);
    if (!numbers) {
        free(i);
        return NULL;
    }
    i->numbers = numbers;
    layout_parts(i, numbers);
    i->workspace = numbers + i->count;
    i->before = i->workspace + s->workspace;
    i->scratch = i->before + i->count;
    i->registers = i->scratch + i->room;
    i->lanes = lanes_align(i->registers + s->registers);
    i->spare = i->lanes + LANES * (size_t)s->lane_registers;
    i->past_before = i->spare + s->spare;
    i->kept_before = i->past_before + s->past_size;
    i->dense = i->kept_before + s->held + s->followed_count * HEARD;
    i->read_at = i->dense + linear_least_norm_work(s->dense, s->dense);
    i->breaks = i->read_at + 2 * s->n + s->inputs;
    registers_load(i);
    instance_reset(i);
    return i;
}

void instance_free(Instance *i)
{
    if (i) {
        gradient_free(i->gradient);
        gradient_free(i->of_step);
        free(i->numbers);
        free(i);
    }
}

void instance_reset(Instance *i)
{
    const Scene *s = i->scene;
    const Variable *v = s->variables;
    memset(i->numbers, 0, i->count * sizeof *i->numbers);
    memset(&i->flags, 0, sizeof i->flags);
    i->flags.phase = INSTANTIATED;
    i->stop = INFINITY;
    i->stabilisation[0] = ZETA;
    i->stabilisation[1] = OMEGA;
    *i->projection = -1.0;
    *i->length = 1.0;
    for (int k = 0; k < s->parameters; k++)
        i->values[k] = v[k].start;
    v += s->parameters;
    for (int k = 0; k < s->choices; k++)
        i->flags.choice[k] = s->choice[k].start;
    v += s->choices;
    for (int k = 0; k < s->inputs; k++) {
        i->m[s->u + k] = v[k].start;
        i->slopes[1 + k] = s->no_slope;
    }
    for (int k = 0; k < s->switches; k++)
        i->requested[k] = s->switched[k].start;
}
