#include "friction_events.h"

#include "fixed.h"
#include "friction.h"
#include "instance.h"
#include "layout.h"
#include "message.h"
#include "robust.h"
#include "scene.h"
#include "scene_sizes.h"
#include "settings.h"

/* Compute the distance of each joint from its event, negative beyond it: the rate of a sliding joint in its direction,
   the reserve of a sticking joint's multiplier relative to its limit, or how far the rate of a joint held by others is
   below that of a moving joint. */
void friction_distances(Instance *i, double *found)
{
    const Scene *s = i->scene;
    friction_rates(i, found);
    if (friction_count_sticking(i)) {
        const double *grip = friction_gripped(i);
        for (int k = 0; k < s->frictions; k++)
            if (*friction_slip(i, k) == 0.0)
                found[k] = 1.0 + EXCEEDED - fabs(grip[k]) / (grip[s->frictions + k] + DBL_MIN);
    }
    for (int k = 0; k < s->frictions; k++)
        if (fabs(*friction_slip(i, k)) == 1.0)
            found[k] *= *friction_slip(i, k);
        else if (*friction_slip(i, k) != 0.0)
            found[k] = MOVING * friction_rest(i) - fabs(found[k]);
}

/* Return the least distance of the joints that meet an event in this step, each in its own unit. */
static double find_least_distance(const double *rooms, const unsigned char *meets, const double *units, int count)
{
    double found = INFINITY;
    for (int k = 0; k < count; k++)
        if (meets[k] && !(rooms[k] / units[k] >= found))
            found = rooms[k] / units[k];
    return found;
}

/* Compute the accelerations of sliding joints in their directions. */
static void find_second_rates(Instance *i, double *found)
{
    const double *grip = friction_gripped(i);
    for (int k = 0; k < i->scene->frictions; k++)
        found[k] = fabs(*friction_slip(i, k)) == 1.0 ? *friction_slip(i, k) * grip[2 * i->scene->frictions + k] : 0.0;
}

/* Return whether the cubic through both ends of a step of length h lets the rate of a joint cross zero and return. */
static int has_crossing(double rest, double before, double after, double bend_before, double bend_after, double h)
{
    const double slope = bend_before * h, end = bend_after * h, change = after - before;
    const double square = 3 * change - 2 * slope - end, cube = slope + end - 2 * change;
    if (!(slope < 0.0 && end > 0.0))
        return 0;
    for (int k = 1; k < SEEN_BETWEEN; k++) {
        const double x = (double)k / SEEN_BETWEEN;
        if (before + x * (slope + x * (square + x * cube)) < -rest)
            return 1;
    }
    return 0;
}

/* Return whether a jam, as with nearly aligned links, is here or within an internal step ahead. */
static int find_jam_ahead(Instance *i)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *z = instance_field(i, s->z), *kept = arena_alloc(i, (size_t)s->n);
    int found = friction_jammed(i);
    memcpy(kept, z, (size_t)s->n * sizeof *z);
    for (double ahead = 1.0; !found && ahead > JAM_AHEAD; ahead /= JAM_SHORTER) {
        for (int c = 0; c < s->n; c++)
            z[c] = kept[c] + ahead * i->values[s->step_size] * z[s->n + c];
        found = friction_jammed(i);
    }
    memcpy(z, kept, (size_t)s->n * sizeof *z);
    arena_release(i, arena);
    return found;
}

/* Take one step, or all steps to the end if `all` is set, by the integrator of the scene. */
static Outcome make_step(Instance *i, double end, double dt, int all)
{
    double *time = instance_time(i);
    Outcome outcome = DONE;
    do {
        const double from = *time, left = end - from;
        const int last = left <= dt * (1 + ONE_STEP);
        if (run_is_ended(i) || settings_method(i)) {
            outcome = step_adaptive_to(i, end, dt, 1);
        } else {
            const double step = last ? left : dt;
            outcome = step_rk4(i, from, step);
            if (outcome == DONE)
                *time = last ? end : from + step;
        }
        if (outcome == DONE && i->left <= 0 && *time < end)
            outcome = step_adaptive_to(i, end, dt, 1);
    } while (all && outcome == DONE && *time < end);
    if (outcome != DONE && !i->ended && i->left > 0 && find_jam_ahead(i))
        return friction_say_jam(i);
    return outcome;
}

typedef struct {
    double *state, *pace, *peaks; /* before the step */
    size_t size, count;
} Step_memory;

static void restore_step(Instance *i, const Step_memory *kept)
{
    memcpy(instance_field(i, i->scene->z), kept->state, kept->size);
    settings_count_turns(i);
    memcpy(i->peaks, kept->peaks, scene_peaks_length(i->scene) * sizeof *i->peaks);
    memcpy(instance_field(i, i->scene->pace), kept->pace, kept->count * sizeof *kept->pace);
}

/* Take the last step back and repeat it up to the first event in it; report the joints that meet this event. */
static Outcome locate_event(Instance *i, const Step_memory *kept, const double *before, const double *after,
    const unsigned char *meets, double dt)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    const int count = s->frictions;
    double *now = arena_alloc(i, (size_t)count), *units = arena_alloc(i, (size_t)count);
    const double start = kept->state[s->time];
    double low = start, high = *instance_time(i), at_low, at_high, there, scale = INFINITY;
    double weight_low = 1.0, weight_high = 1.0;
    const double early = EARLIEST * i->values[s->step_size];
    Outcome outcome = DONE;
    /* The search compares joints that turn with joints that slide: the unit of each is its largest distance. */
    for (int k = 0; k < count; k++) {
        units[k] = fmax(fmax(fabs(before[k]), fabs(after[k])), DBL_MIN);
        if (meets[k])
            scale = fmin(scale, fmax(1.0, NEARLY_STOPPED * friction_rest(i) / (STOPPED * units[k])));
    }
    at_low = find_least_distance(before, meets, units, count);
    there = at_high = find_least_distance(after, meets, units, count);
    for (int pass = 0; pass < SEARCHED && outcome == DONE; pass++) {
        double t;
        if (fabs(there) <= STOPPED * scale || high - low <= 4 * DBL_EPSILON * fmax(fabs(high), early))
            break;
        if (at_low <= 0.0) /* The joint has only begun to move: the event is here or later. */
            t = low + (high - low) * RIGHT_THERE;
        else if (pass % 8 == 7)
            t = (low + high) / 2;
        else
            t = low + (high - low) * (weight_low * at_low) / (weight_low * at_low - weight_high * at_high);
        if (!(t > low && t < high))
            t = (low + high) / 2;
        restore_step(i, kept);
        outcome = make_step(i, t, dt, 1);
        if (outcome != DONE)
            break;
        friction_distances(i, now);
        there = find_least_distance(now, meets, units, count);
        if (there < 0.0) {
            if (at_low <= 0.0) { /* The joint moves in the wrong direction from the beginning. */
                restore_step(i, kept);
                break;
            }
            high = t;
            at_high = there;
            weight_high = 1.0;
            weight_low /= 2.0;
        } else {
            low = t;
            at_low = there;
            weight_low = 1.0;
            weight_high /= 2.0;
        }
    }
    arena_release(i, arena);
    return outcome;
}

/* Take steps with dry friction up to the end of a communication step, with internal RK4 steps of length dt. */
Outcome friction_cover(Instance *i, double start, double h, double dt)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), count = (size_t)s->frictions, past = (size_t)(s->past + s->past_size - s->pace);
    const double end = start + h;
    double *time = instance_time(i), *before = arena_alloc(i, count), *after = arena_alloc(i, count);
    double *bend_before = arena_alloc(i, count), *bend_after = arena_alloc(i, count), within = INFINITY;
    const double rest = friction_rest(i), brief = LOOKED_INTO * i->values[s->step_size];
    const int looks = settings_method(i) != 0; /* The user sets the length of RK4 steps. */
    unsigned char *meets = (unsigned char *)arena_alloc(i, count);
    Step_memory kept = {arena_alloc(i, scene_state_length(s)), arena_alloc(i, past),
        arena_alloc(i, scene_peaks_length(s)), scene_state_length(s) * sizeof(double), past};
    int at_once = 0;
    Outcome outcome = friction_checked(i);
    while (outcome == DONE && *time < end) {
        const double from = *time;
        double limit = end;
        int any = 0;
        /* The load of sticking joints is checked at least once per internal step length. */
        if (friction_count_sticking(i) && end - from > i->values[s->step_size] * (1 + ONE_STEP))
            limit = from + i->values[s->step_size];
        limit = fmin(limit, from + within);
        within = INFINITY;
        memcpy(kept.state, instance_field(i, s->z), kept.size);
        memcpy(kept.pace, instance_field(i, s->pace), past * sizeof(double));
        memcpy(kept.peaks, i->peaks, scene_peaks_length(s) * sizeof(double));
        friction_distances(i, before);
        if (looks && friction_count_sticking(i) < (int)count)
            find_second_rates(i, bend_before);
        outcome = make_step(i, limit, dt, 0);
        if (outcome != DONE)
            break;
        friction_distances(i, after);
        for (size_t k = 0; k < count; k++) {
            meets[k] = !(after[k] >= (fabs(*friction_slip(i, (int)k)) == 1.0 ? -rest : 0.0));
            any |= meets[k];
        }
        if (!any && looks && friction_count_sticking(i) < (int)count && *time - from > brief) {
            find_second_rates(i, bend_after);
            for (size_t k = 0; k < count; k++)
                if (fabs(*friction_slip(i, (int)k)) == 1.0
                    && has_crossing(rest, before[k], after[k], bend_before[k], bend_after[k], *time - from))
                    within = (*time - from) / 2;
            if (within < INFINITY) { /* Repeat the step in halves. */
                restore_step(i, &kept);
                continue;
            }
        }
        if (!any) {
            at_once = 0;
            continue;
        }
        outcome = locate_event(i, &kept, before, after, meets, dt);
        if (outcome != DONE)
            break;
        friction_distances(i, after);
        {
            double first = INFINITY;
            for (size_t k = 0; k < count; k++)
                first = meets[k] ? fmin(first, after[k]) : first;
            for (size_t k = 0; k < count; k++)
                meets[k] = meets[k] && fabs(*friction_slip(i, (int)k)) == 1.0 && after[k] <= fmax(fabs(first), rest);
        }
        at_once = *time > from ? 0 : at_once + 1;
        if (at_once == AT_ONCE)
            outcome = instance_say(i, FAILED,
                "%s, t = %.6g s: no combination of sticking and sliding of the joints with dry friction agrees with "
                "their loads here; change coefficients of friction a little",
                s->name, *time);
        else
            outcome = friction_event(i, meets);
    }
    arena_release(i, arena);
    return outcome;
}
