/* Save, check and restore the state of an instance. */

#include "state.h"

#include "exchange.h"
#include "instance.h"
#include "layout.h"
#include "message.h"
#include "scene.h"
#include "scene_sizes.h"
#include "settings.h"
#include "variables.h"

#define FORMAT 9
#define MAGIC 0x464d4c41u /* "ALMF" */

void instance_remember(Instance *i)
{
    memcpy(i->before, i->numbers, i->count * sizeof *i->numbers);
    i->flags_before = i->flags;
}

void instance_go_back(Instance *i)
{
    memcpy(i->numbers, i->before, i->count * sizeof *i->numbers);
    i->flags = i->flags_before;
    i->onward = 0; /* The outputs may have been evaluated elsewhere. */
}

typedef struct {
    unsigned magic, format, sum; /* check sum of the whole state with zero in its place */
    size_t count;
    char guid[48];
    Flags flags;
} Head;

static Head head_of(const Instance *i)
{
    Head h;
    memset(&h, 0, sizeof h);
    h.magic = MAGIC;
    h.format = FORMAT;
    h.count = i->count;
    strncpy(h.guid, i->scene->guid, sizeof h.guid - 1);
    h.flags = i->flags;
    h.flags.known = 0; /* Outputs are evaluated again after a restore. */
    return h;
}

size_t state_size(const Instance *i)
{
    return sizeof(Head) + i->count * sizeof *i->numbers;
}

/* Return the check sum that a state had when it was saved. */
static unsigned state_sum(const unsigned char *state, size_t size)
{
    const unsigned nothing = 0;
    const size_t at = offsetof(Head, sum);
    unsigned sum = scene_check_sum(CHECK_BEGIN, state, at);
    sum = scene_check_sum(sum, (const unsigned char *)&nothing, sizeof nothing);
    return ~scene_check_sum(sum, state + at + sizeof nothing, size - at - sizeof nothing);
}

void state_save(const Instance *i, unsigned char *state)
{
    const Scene *s = i->scene;
    const double *memory = i->m;
    const struct {
        const double *numbers;
        size_t count;
    } scratch[] = {{memory + s->after, scene_state_length(s)}, {memory + s->begin, scene_state_length(s)},
        {memory + s->seen, (size_t)s->seen_size}, {i->slopes, 1}};
    Head h = head_of(i);
    memcpy(state + sizeof h, i->numbers, i->count * sizeof *i->numbers);
    /* Exclude scratch data of steps and evaluations, on which nothing depends. */
    for (size_t k = 0; k < sizeof scratch / sizeof *scratch; k++)
        memset(state + sizeof h + (size_t)(scratch[k].numbers - i->numbers) * sizeof(double), 0,
            scratch[k].count * sizeof(double));
    memcpy(state, &h, sizeof h);
    h.sum = state_sum(state, state_size(i));
    memcpy(state, &h, sizeof h);
}

/* Return whether a saved state belongs to this mechanism and is unchanged. */
int state_whole(const Instance *i, const unsigned char *state, size_t size)
{
    const Head mine = head_of(i);
    Head h;
    if (size != state_size(i))
        return 0;
    memcpy(&h, state, sizeof h);
    return h.magic == mine.magic && h.format == mine.format && h.count == mine.count
        && !memcmp(h.guid, mine.guid, sizeof h.guid) && h.sum == state_sum(state, size);
}

static Outcome report_unsound(Instance *i, const char *what, double value)
{
    return instance_say(i, REFUSED, "%s: %s of the saved state is %g, which is not possible; save it again",
        i->scene->name, what, value);
}

/* Return DONE, or report a number in the restored state that no instance can have, indices and bounds first. */
static Outcome check_state(Instance *i)
{
    const Scene *s = i->scene;
    const Flags *f = &i->flags;
    const Variable *inputs = s->variables + s->parameters + s->choices;
    const double *control = instance_field(i, s->control);
    const int flags[] = {f->initialized, f->known, f->scaled, f->fast, f->whole, f->pending, f->brakes,
        f->warned & ~EVERY_WARNING};
    const struct {
        const char *name;
        const double *numbers;
        int count;
    } parts[] = {
        {"the motion", instance_field(i, s->z), (int)scene_state_length(s)},
        {"a parameter", instance_field(i, s->p), s->own + s->held},
        {"a penalty", i->penalty, s->l},
        {"a penalty", i->full, s->l},
        {"a unit", i->units, s->l},
        {"a scale", i->scales, s->n},
        {"a length", i->length, 1},
        {"a length", i->loop, 1},
        {"a direction", instance_field(i, s->k) + scene_way(s), scene_matrix(s) - scene_way(s)},
        {"a compliance", i->compliances, s->compliances},
        {"a lock", i->discrete, s->held},
        {"a signal", i->input_history, s->followed_count * HEARD},
        {"an impulse", i->impulses, s->impulses},
        {"energy lost", i->dissipated, 1},
        {"a derivative of the last step", i->jacobian, s->entries},
        {"a state", i->exchange, 2 * scene_exchanged(s)},
        {"a peak", i->peaks, (int)scene_peaks_length(s)},
        {"a step size", control, 1},
        {"a past input", instance_field(i, s->past), s->past_size},
    };
    for (size_t k = 0; k < sizeof flags / sizeof *flags; k++)
        if (flags[k] != 0 && flags[k] != 1)
            return report_unsound(i, "a flag", flags[k]);
    for (int k = 0; k < s->choices; k++)
        if (f->choice[k] < 0 || f->choice[k] >= s->choice[k].count)
            return report_unsound(i, s->variables[s->parameters + k].name, f->choice[k]);
    for (int k = 0; k < s->parameters; k++)
        if (variable_check(i, s->variables + k, i->values[k]) != DONE)
            return report_unsound(i, s->variables[k].name, i->values[k]);
    for (int k = 0; k < s->inputs; k++)
        if (variable_check(i, inputs + k, i->m[s->u + k]) != DONE)
            return report_unsound(i, inputs[k].name, i->m[s->u + k]);
    for (int k = 0; k < s->inputs; k++)
        if (i->slopes[1 + k] != s->no_slope && !isfinite(i->slopes[1 + k]))
            return report_unsound(i, "the derivative of an input", i->slopes[1 + k]);
    if (f->mode < 0 || f->mode > CONTINUOUS)
        return report_unsound(i, "the mode", f->mode);
    for (int k = 0; k < s->switches; k++)
        if ((i->requested[k] != 0.0 && i->requested[k] != 1.0) || (i->active[k] != 0.0 && i->active[k] != 1.0))
            return report_unsound(i, inputs[s->inputs + k].name, i->requested[k]);
    if (!(f->phase & ANY) || (f->phase & (f->phase - 1)) || (f->phase & RUN && !f->initialized))
        return report_unsound(i, "the phase", f->phase);
    for (int k = 0; k < s->followed_count; k++)
        for (int each = 0; each < 2; each++) {
            const double count = i->input_history[k * HEARD + each];
            if (!(count >= 0.0 && count <= (each ? 2 : HEARD_POINTS) && count == floor(count)))
                return report_unsound(i, "the history of an input", count);
        }
    for (int k = 0; k < s->frictions; k++) {
        const double slip = i->discrete[s->friction[k].slip];
        if (f->initialized && slip != 0.0 && fabs(slip) != 1.0 && fabs(slip) != LIMITED && slip != SHARED)
            return report_unsound(i, "the direction of friction", slip);
    }
    if (!isfinite(*instance_time(i)))
        return report_unsound(i, "the time", *instance_time(i));
    if (!f->initialized) /* The start of a run computes the rest. */
        return DONE;
    for (size_t part = 0; part < sizeof parts / sizeof *parts; part++)
        for (int k = 0; k < parts[part].count; k++)
            if (!isfinite(parts[part].numbers[k]))
                return report_unsound(i, parts[part].name, parts[part].numbers[k]);
    if (control[CONTROL_STEP_SIZE] != i->values[s->step_size] ||
        (control[CONTROL_TIER] != 0.0 && control[CONTROL_TIER] != 1.0))
        return report_unsound(i, "the tier of steps", control[CONTROL_TIER]);
    if (control[CONTROL_METHOD] != settings_method(i))
        return report_unsound(i, "the method", control[CONTROL_METHOD]);
    return DONE;
}

/* Restore a saved state. A rejected state changes nothing. */
Outcome state_restore(Instance *i, const unsigned char *state, size_t size)
{
    Head h;
    Outcome outcome;
    if (!state_whole(i, state, size))
        return instance_say(i, REFUSED,
            "%s: the saved state is not one of this mechanism, or has changed since (check sum); save it again",
            i->scene->name);
    memcpy(&h, state, sizeof h);
    instance_remember(i);
    i->flags = h.flags;
    memcpy(i->numbers, state + sizeof h, i->count * sizeof *i->numbers);
    outcome = check_state(i);
    if (outcome != DONE)
        instance_go_back(i);
    return outcome;
}
