/* Derivatives of readings at an instant, for hosts: of outputs with respect to inputs and, before the run begins, to
   parameters and start values, in forward or adjoint mode. The evaluation (and the start) is recorded on a tape,
   which is then swept; the instance does not change. */

#include "instant_derivatives.h"

#include "begin.h"
#include "diagnosis.h"
#include "exchange.h"
#include "gradient.h"
#include "instance.h"
#include "message.h"
#include "outputs.h"
#include "record.h"
#include "scene.h"
#include "scene_sizes.h"
#include "state.h"
#include "tangent.h"
#include "variables.h"

/* Return whether a run can be differentiated with respect to a variable: a parameter, a start value, a first-order
   state or an input. */
int variable_has_derivatives(const Scene *s, int reference)
{
    const int starts = s->own + 2 * s->starts, states = starts + s->compliances;
    const Variable *v = s->variables + reference;
    if (v->kind == INPUT)
        return 1;
    return v->kind == PARAMETER
        && (reference < starts || (reference >= states && reference < s->parameters - s->solver));
}

/* Return whether inputs prescribe positions while the run begins. */
int instance_moves_start(const Instance *i)
{
    return i->scene->followed_count && !(i->flags.phase & RUN);
}

/* Record the evaluation of the outputs, the start too if `of_start` is set, and rates of states if they are wanted, on
   the tape. */
static Outcome record_evaluation(Instance *i, Gradient *g, int of_start, int wanted)
{
    Outcome outcome = DONE;
    tape_clear(g->tape);
    if (of_start)
        outcome = diagnose_derivatives(i);
    i->tape = g->tape;
    if (outcome == DONE && of_start)
        outcome = instance_initialize(i);
    i->flags.known = i->onward = 0;
    if (outcome == DONE)
        outcome = exchange_or_read(i, wanted);
    i->tape = NULL;
    if (outcome == DONE && g->tape->lost)
        outcome = instance_say(i, FAILED, "%s: there is not enough memory for derivatives", i->scene->name);
    return outcome;
}

static int32_t variable_place(const Instance *i, unsigned reference)
{
    return tape_place_of(i, instance_place(i, (int)reference));
}

Outcome instance_sweep(Instance *i, const unsigned *unknowns, size_t unknown_count, const unsigned *knowns,
    size_t known_count, const double *seed, Sweep *back, double *found)
{
    const Mark begin = {0, 0, 0};
    const size_t count = back ? known_count : unknown_count;
    Gradient *g;
    Outcome outcome;
    int of_start = 0, exchanged = 0;
    for (size_t k = 0; k < known_count; k++)
        of_start |= knowns[k] < (unsigned)i->scene->parameters || instance_moves_start(i);
    for (size_t k = 0; k < unknown_count; k++)
        exchanged |= unknowns[k] >= (unsigned)scene_variable_count(i->scene);
    if (!i->gradient)
        i->gradient = gradient_new(i, 1);
    g = i->gradient;
    if (!g)
        return instance_say(i, FAILED, "%s: there is not enough memory for derivatives", i->scene->name);
    instance_remember(i);
    outcome = record_evaluation(i, g, of_start, exchanged);
    instance_go_back(i);
    arena_reset(i);
    if (outcome != DONE)
        return outcome;
    if (back) {
        memset(g->adjoints, 0, g->places * sizeof *g->adjoints);
        for (size_t k = 0; k < unknown_count; k++)
            g->adjoints[variable_place(i, unknowns[k])] += seed[k];
        back(g, begin);
        for (size_t k = 0; k < known_count; k++)
            found[k] = g->adjoints[variable_place(i, knowns[k])];
    } else {
        memset(g->tangents, 0, g->places * sizeof *g->tangents);
        for (size_t k = 0; k < known_count; k++)
            g->tangents[variable_place(i, knowns[k])].lane[0] += seed[k];
        tangents_along(g, begin);
        for (size_t k = 0; k < unknown_count; k++)
            found[k] = g->tangents[variable_place(i, unknowns[k])].lane[0];
    }
    arena_reset(i);
    for (size_t k = 0; k < count; k++)
        if (!isfinite(found[k]))
            return instance_say(i, FAILED,
                "%s, t = %.6g s: derivatives are not finite here, for example at a square root of zero; change the "
                "state or input a little",
                i->scene->name, *instance_time(i));
    return DONE;
}
