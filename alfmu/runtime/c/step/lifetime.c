#include "lifetime.h"

#include <stdlib.h>

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

/* Set the pointers to the parts of `numbers`, one after another; return their total length. */
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
        {&i->least_margin, 1},
        {&i->regular, 1},
        {&i->rank, 1},
        {&i->largest_penalty, 1},
        {&i->length, 1},
        {&i->loop, 1},
        {&i->agreed, 1},
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

/* Return the length of an instance's scratch memory, for its start (which determines ranks) or for steps only. */
static size_t scratch_length(const Scene *s, int starts)
{
    const size_t side = (size_t)(s->n + s->l + s->ties + 1), kept = (size_t)(s->past + s->past_size - s->pace);
    /* A step has one mass matrix and one constraint matrix at a time. */
    size_t room = 8 * side + (size_t)(s->mass.entries + s->constraint.entries) + kept;
    if (starts) /* Matrices for singular values are dense; the others are sparse. */
        room += (s->n <= DENSE ? 12 * side * side : 0) + (size_t)56 * side + s->closing.entries + s->holding.entries
            + 15 * (size_t)(s->mass.entries + s->constraint.entries)
            + 16 * (size_t)(s->gaps.entries + s->tie_rows.entries);
    room += 4 * (size_t)(scene_driven(s) + s->outputs) + laws_room(s) + breaks_room(s) + peaks_room(s)
        + (size_t)s->limit_count * (2 + (size_t)s->n);
    if (s->frictions) /* memory of steps up to events */
        room += (size_t)(18 * s->frictions + 2 * s->held) + kept + scene_state_length(s) + scene_peaks_length(s);
    return room;
}

/* Set the pointers of an instance to the `numbers` that it keeps between calls, unless NULL; return their count. */
static size_t layout_kept(Instance *i, double *numbers)
{
    const Scene *s = i->scene;
    i->count = layout_parts(i, numbers);
    if (numbers) {
        i->numbers = numbers;
        i->workspace = numbers + i->count; /* workspace of programs: it follows the memory, which is the last part */
        i->read_at = i->workspace + s->workspace;
        i->breaks = i->read_at + 2 * s->n + s->inputs;
    }
    return i->count + (size_t)s->workspace + 2 * (size_t)s->n + (size_t)s->inputs
        + (s->break_count ? 2 * MOST_BREAKS : 0);
}

/* Set the pointers of an instance to the numbers that it uses only during calls, unless NULL; return their count. */
static size_t layout_lent(Instance *i, double *numbers, int starts)
{
    const Scene *s = i->scene;
    const size_t least_norm = linear_least_norm_work(s->dense, s->dense);
    const size_t held = (size_t)(s->held + s->followed_count * HEARD);
    i->room = scratch_length(s, starts);
    if (numbers) {
        i->before = numbers;
        i->scratch = i->before + i->count;
        i->registers = i->scratch + i->room;
        i->lanes = lanes_align(i->registers + s->registers);
        i->spare = i->lanes + LANES * (size_t)s->lane_registers;
        i->past_before = i->spare + s->spare;
        i->kept_before = i->past_before + s->past_size;
        i->dense = i->kept_before + held;
    }
    return i->count + i->room + (size_t)s->registers + LANES * ((size_t)s->lane_registers + 1) + (size_t)s->spare
        + (size_t)s->past_size + held + least_norm;
}

size_t instance_length(const Scene *s, int starts)
{
    return instance_kept_length(s) + instance_lent_length(s, starts);
}

size_t instance_kept_length(const Scene *s)
{
    Instance i;
    i.scene = s;
    return layout_kept(&i, NULL);
}

size_t instance_lent_length(const Scene *s, int starts)
{
    Instance i;
    i.scene = s;
    layout_kept(&i, NULL);
    return layout_lent(&i, NULL, starts);
}

void instance_borrow(Instance *i, double *lent, int starts)
{
    layout_lent(i, lent, starts);
}

void instance_lay(Instance *i, const Scene *s, double *numbers, double *lent, int starts)
{
    i->scene = s;
    numbers += layout_kept(i, numbers);
    instance_borrow(i, lent ? lent : numbers, starts);
    registers_load(i);
    instance_reset(i);
}

Instance *instance_new(const Scene *s)
{
    Instance *i = calloc(1, sizeof *i);
    double *numbers = i ? calloc(instance_length(s, 1), sizeof *numbers) : NULL;
    if (numbers)
        instance_lay(i, s, numbers, NULL, 1);
    else
        free(i);
    return numbers ? i : NULL;
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
    *i->length = *i->loop = 1.0;
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
