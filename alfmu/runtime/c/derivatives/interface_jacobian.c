/* The interface Jacobian: derivatives of outputs at the end of a communication step with respect to inputs held over
   it.

   Each internal step is recorded on a tape, swept forward and discarded, so that memory does not grow with the
   communication step. Apart from its inputs, the state at the start of the step is constant. */

#include "interface_jacobian.h"

#include "gradient.h"
#include "instance.h"
#include "lanes.h"
#include "message.h"
#include "record.h"
#include "scene.h"
#include "scene_sizes.h"
#include "tangent.h"

static Lanes *tangents_of(const Gradient *g, int direction, const double *number)
{
    return g->tangents + (size_t)(direction / LANES) * g->places + (size_t)tape_place_of(g->instance, number);
}

/* Initialise the tangents before a communication step; an internal step that continues one continues its tangents. */
Outcome jacobian_begin(Instance *i)
{
    const Scene *s = i->scene;
    Gradient *g = i->of_step;
    if (!g)
        g = i->of_step = gradient_new(i, s->directions);
    if (!g)
        return instance_say(i, FAILED, "%s: there is not enough memory for derivatives", s->name);
    if (!i->within) {
        /* The evaluation of the outputs was not recorded, so the step must not reuse it. */
        i->onward = 0;
        for (int block = 0; block < g->blocks; block++)
            memset(g->tangents + (size_t)block * g->places, 0, i->count * sizeof *g->tangents);
        for (int k = 0; k < s->entries; k++) {
            const int direction = s->jacobian[k].direction;
            tangents_of(g, direction, i->m + s->u + s->jacobian[k].input)->lane[direction % LANES] = 1.0;
        }
    }
    tape_clear(g->tape);
    g->lost = g->tape->lost = 0;
    i->tape = g->tape;
    return DONE;
}

/* Return the present value of an entry. */
static double derivative(const Instance *i, int entry)
{
    const Scene *s = i->scene;
    const int direction = s->jacobian[entry].direction;
    const double *output = i->m + s->seen + s->jacobian[entry].output;
    return tangents_of(i->of_step, direction, output)->lane[direction % LANES];
}

/* Propagate the tangents along the recorded steps. */
void jacobian_along(Instance *i)
{
    const Mark begin = {0, 0, 0};
    if (i->of_step && i->tape == i->of_step->tape) {
        tangents_along(i->of_step, begin);
        tape_clear(i->tape);
    }
}

/* Store the Jacobian after the outputs of a step were evaluated; FAILED if a derivative is not finite. */
Outcome jacobian_end(Instance *i)
{
    const Scene *s = i->scene;
    const Gradient *g = i->of_step;
    if (!g || i->tape != g->tape)
        return DONE;
    jacobian_along(i);
    if (g->lost || g->tape->lost)
        return instance_say(i, FAILED, "%s: there is not enough memory for derivatives", s->name);
    for (int k = 0; k < s->entries; k++)
        if (!isfinite(derivative(i, k)))
            return instance_say(i, FAILED,
                "%s, t = %.6g s: %s cannot be computed over this step, for example at a square root of zero or where "
                "a rank is uncertain; take another communication step or input, or leave this output out",
                s->name, *instance_time(i), s->variables[scene_first_output(s) + s->outputs + k].name);
    for (int k = 0; k < s->entries; k++)
        i->jacobian[k] = derivative(i, k);
    return DONE;
}
