/* Dry friction that follows from the load: when joints stick and slide, and steps up to these events.

   While a joint slides, its direction s is 1 or -1 and accelerations contain its friction; while it sticks, s is 0 and
   the constraint of the joint is in force. An event changes s: the rate of a sliding joint crosses zero, or the
   multiplier of a sticking joint exceeds its limit. A step over an event is taken back and repeated up to it.

   As many joints stick as there are motions to hold; these hold the others at rest, which are at their limit (LIMITED)
   or use a share of it (SHARED). */

#include "friction.h"

#include <stdio.h>

#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "message.h"
#include "projection.h"
#include "rank.h"
#include "scene.h"
#include "settings.h"

/* Number of passes after which shares of friction are extrapolated; those of most mechanisms settle in fewer. */
#define EXTRAPOLATED 20

double *friction_slip(const Instance *i, int k)
{
    return i->discrete + i->scene->friction[k].slip;
}

int friction_count_sticking(const Instance *i)
{
    int count = 0;
    for (int k = 0; k < i->scene->frictions; k++)
        count += *friction_slip(i, k) == 0.0;
    return count;
}

/* Release all joints, at the start and before an impact. */
void friction_reset(Instance *i)
{
    for (int k = 0; k < i->scene->frictions; k++)
        *friction_slip(i, k) = 1.0;
}

void friction_rates(Instance *i, double *rates)
{
    const Scene *s = i->scene;
    const double *z = instance_field(i, s->z), *x[] = {z, z + s->n, instance_field(i, s->p)};
    double *y[] = {rates};
    function_call(i, s->sliding, x, y);
}

/* Run the program `gripping`. Return its results: multipliers, limits, accelerations of joints, the remainder of the
   friction laws, and the least pivot. */
const double *friction_gripped(Instance *i)
{
    program_run(i, i->scene->gripping);
    return i->workspace + i->scene->grip;
}

/* Return whether the friction laws have no solution here, or nearly none. */
int friction_jammed(Instance *i)
{
    const Scene *s = i->scene;
    const double *grip;
    if (!s->frictions || s->gripping < 0 || friction_count_sticking(i) == s->frictions)
        return 0;
    grip = friction_gripped(i) + 3 * s->frictions;
    return !(grip[0] <= JAM_SETTLED * JAM_SETTLED) || !(grip[1] > JAM_PIVOT);
}

/* Append the name of a joint to a list. */
static void append_name(const Instance *i, int k, char *names, size_t size)
{
    const Scene *s = i->scene;
    char part[64];
    snprintf(part, sizeof part, "%s%.40s", *names ? ", " : "", s->rows[s->friction[k].row].name);
    strncat(names, part, size - strlen(names) - 1);
}

Outcome friction_say_jam(Instance *i)
{
    const Scene *s = i->scene;
    char names[300] = "";
    for (int k = 0; k < s->frictions; k++)
        if (fabs(*friction_slip(i, k)) == 1.0 || *friction_slip(i, k) == SHARED)
            append_name(i, k, names, sizeof names);
    return instance_say(i, FAILED,
        "%s, t = %.6g s: joints jam: no sliding motion has friction that agrees with its load (%s)%s; the load grows "
        "with its own friction without bound: use smaller coefficients of friction, smaller radii or a longer guide",
        s->name, *instance_time(i), names, s->timed ? ", but a law of time prescribes one" : "");
}

/* Activate the constraints of sticking joints and deactivate those of the others. */
static void update_rows_in_force(Instance *i)
{
    const Scene *s = i->scene;
    for (int k = 0; k < s->frictions; k++) {
        const int row = s->friction[k].row;
        i->penalty[row] = *friction_slip(i, k) == 0.0 ? i->full[row] : 0.0;
    }
    settings_upload_parameters(i);
    settings_set_penalties(i);
}

/* Make a joint stick at its present displacement. */
static void make_stick(Instance *i, int k)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *displacements = arena_alloc(i, (size_t)s->held);
    const double *x[] = {instance_field(i, s->z), instance_field(i, s->p)};
    double *y[] = {displacements};
    function_call(i, s->displacements, x, y);
    i->discrete[s->friction[k].value] = displacements[s->friction[k].value];
    *friction_slip(i, k) = 0.0;
    arena_release(i, arena);
}

/* Return the acceleration of a joint at rest if its friction is a share of its limit; NaN beyond a jam, where no load
   balances its own friction. */
static double find_second_rate(Instance *i, int k, double share)
{
    const int count = i->scene->frictions;
    const double *grip;
    i->discrete[i->scene->friction[k].value] = share;
    settings_upload_parameters(i);
    grip = friction_gripped(i);
    if (!(grip[3 * count] <= JAM_SETTLED * JAM_SETTLED && grip[3 * count + 1] > 0.0))
        return NAN;
    return grip[2 * count + k];
}

/* Return the share of its limit that holds a joint at rest while the others keep theirs; 1 or -1 if the whole limit
   is too little. */
static double find_holding_share(Instance *i, int k, double share, double idle)
{
    double now = find_second_rate(i, k, share), low, high, at_low, at_high;
    const double way = now > 0.0 ? 1.0 : -1.0;
    if (isnan(now))
        return 0.0;
    if (fabs(now) <= idle)
        return share;
    if (share == way)
        return share;
    at_high = way * find_second_rate(i, k, way);
    if (at_high >= 0.0)
        return way;
    low = way * share, high = 1.0, at_low = way * now;
    for (int pass = 0; pass < SEARCHED && high - low > 4 * DBL_EPSILON; pass++) {
        /* Beyond a jam only the direction is known. */
        const double at
            = isnan(at_high) || pass % 4 == 3 ? (low + high) / 2 : low + (high - low) * at_low / (at_low - at_high);
        now = way * find_second_rate(i, k, way * at);
        if (fabs(now) <= idle) {
            low = at;
            break;
        }
        if (now > 0.0) {
            low = at;
            at_low = now;
        } else {
            high = at;
            at_high = now;
        }
    }
    find_second_rate(i, k, way * low);
    return way * low;
}

/* Of the joints at rest that move in spite of their whole limit, let the one with the largest acceleration slide.
   Return 0 if there is none. */
static int let_one_slide(Instance *i, unsigned char *rests, double idle)
{
    const Scene *s = i->scene;
    const int count = s->frictions;
    const double *seconds = friction_gripped(i) + 2 * count;
    double most = idle;
    int which = -1;
    for (int k = 0; k < count; k++) {
        const double share = i->discrete[s->friction[k].value];
        if (rests[k] && fabs(share) == 1.0 && share * seconds[k] > most) {
            most = share * seconds[k];
            which = k;
        }
    }
    if (which < 0)
        return 0;
    *friction_slip(i, which) = i->discrete[s->friction[which].value];
    rests[which] = 0;
    return 1;
}

/* Return to rest one joint that began to slide but stops once others slide too. Return 0 if there is none. */
static int bring_one_to_rest(Instance *i, unsigned char *rests, unsigned char *began, double idle)
{
    const int count = i->scene->frictions;
    const double *seconds = friction_gripped(i) + 2 * count;
    for (int k = 0; k < count; k++)
        if (began[k] && !rests[k] && *friction_slip(i, k) * seconds[k] < -idle) {
            rests[k] = 1;
            began[k] = 0; /* Each joint returns to rest at most once. */
            return 1;
        }
    return 0;
}

/* Return to rest, with its present share of the limit, each joint that began to slide but does not accelerate. */
static void bring_to_rest(Instance *i, unsigned char *rests, const unsigned char *began, double idle)
{
    const Scene *s = i->scene;
    const int count = s->frictions;
    const double *grip = friction_gripped(i);
    for (int k = 0; k < count; k++)
        if (began[k] && !rests[k] && fabs(grip[2 * count + k]) <= idle) {
            rests[k] = 1;
            *friction_slip(i, k) = SHARED;
            i->discrete[s->friction[k].value] = fmin(fmax(grip[k] / (grip[count + k] + DBL_MIN), -1.0), 1.0);
        }
    settings_upload_parameters(i);
}

/* Choose the joints that stick: as many joints at rest as there are motions to hold, those with the largest reserve
   first. These hold the others. */
static void choose_sticking(Instance *i, const unsigned char *rests)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    const int count = s->frictions;
    const double *q = instance_field(i, s->z);
    unsigned char *held = (unsigned char *)arena_alloc(i, (size_t)s->l),
                  *seen = (unsigned char *)arena_alloc(i, (size_t)count);
    double *room = arena_alloc(i, (size_t)count);
    int rank;
    memcpy(room, friction_gripped(i) + count, (size_t)count * sizeof *room);
    for (int r = 0; r < s->l; r++)
        held[r] = i->penalty[r] > 0.0;
    for (int k = 0; k < count; k++) {
        const double share = i->discrete[s->friction[k].value];
        seen[k] = !rests[k] || fabs(share) > 1.0 - NO_ROOM;
        room[k] *= 1.0 - fabs(share);
        if (rests[k] && seen[k])
            *friction_slip(i, k) = share > 0.0 ? LIMITED : -LIMITED;
    }
    rank = rank_at(i, q, held);
    for (;;) {
        int which = -1, more;
        for (int k = 0; k < count; k++)
            if (!seen[k] && (which < 0 || room[k] > room[which]))
                which = k;
        if (which < 0)
            break;
        seen[which] = 1;
        held[s->friction[which].row] = 1;
        more = rank_at(i, q, held);
        if (more > rank) {
            rank = more;
            make_stick(i, which);
        } else
            held[s->friction[which].row] = 0;
    }
    arena_release(i, arena);
}

/* Return the rate [rad/s or m/s] of motions that are fast for steps as long as solver.step_size, at most 1. */
static double find_pace(const Instance *i)
{
    return fmin(1.0, SLOW_STEP / i->values[i->scene->step_size]);
}

/* Return the rate below which a joint is at rest. */
double friction_rest(const Instance *i)
{
    return REST * find_pace(i);
}

/* Let joints at their limit slide if nothing holds them and they begin to move. */
static void release_unheld(Instance *i)
{
    const Scene *s = i->scene;
    const int count = s->frictions;
    const double *seconds = friction_gripped(i) + 2 * count;
    double most = pow(find_pace(i), 2);
    for (int k = 0; k < count; k++)
        most = fmax(most, fabs(seconds[k]));
    for (int k = 0; k < count; k++)
        if (fabs(*friction_slip(i, k)) == LIMITED && *friction_slip(i, k) * seconds[k] > IDLE * most)
            *friction_slip(i, k) /= LIMITED;
    settings_upload_parameters(i);
}

/* Extrapolate shares whose steps from pass to pass shrink slowly, as those of hinges about nearly the same axis do. */
static void extrapolate_shares(Instance *i, const unsigned char *rests, const double *steps, double more)
{
    const Scene *s = i->scene;
    for (int k = 0; k < s->frictions; k++)
        if (rests[k]) {
            double *share = i->discrete + s->friction[k].value;
            *share = fmin(fmax(*share + more * steps[k], -1.0), 1.0);
        }
}

/* Decide which joints at rest stick and in which direction the others slide. Each joint in turn takes the share of its
   limit that holds it, until only joints at their whole limit move. This ends because friction opposes motion: a share
   that one joint takes relieves the others. Then the joint with the largest acceleration slides, and the search
   repeats. */
static Outcome decide_sticking(Instance *i, unsigned char *rests)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    const int count = s->frictions;
    unsigned char *began = (unsigned char *)arena_alloc(i, (size_t)count);
    double *steps = arena_alloc(i, (size_t)count), settled = 0.0;
    memcpy(began, rests, (size_t)count);
    for (int again = 0; again <= SLIDING_ROUNDS * count; again++) {
        double idle = IDLE * pow(find_pace(i), 2);
        double most = 1.0;
        int any = 0;
        for (int k = 0; k < count; k++)
            if (rests[k]) {
                *friction_slip(i, k) = SHARED;
                i->discrete[s->friction[k].value] = 0.0;
                any = 1;
            }
        update_rows_in_force(i);
        if (friction_jammed(i)) {
            arena_release(i, arena);
            return friction_say_jam(i);
        }
        for (int k = 0; k < count; k++)
            idle = fmax(idle, IDLE * fabs((i->workspace + s->grip)[2 * count + k]));
        memset(steps, 0, (size_t)count * sizeof *steps);
        for (int pass = 0; any && most > STEADY_SHARE && pass < SHARING_ROUNDS; pass++) {
            double alike = 0.0, squares = 0.0;
            most = 0.0;
            for (int k = 0; k < count; k++)
                if (rests[k]) {
                    const double before = i->discrete[s->friction[k].value],
                                 share = find_holding_share(i, k, before, idle);
                    most = fmax(most, fabs(share - before));
                    i->discrete[s->friction[k].value] = share;
                    alike += (share - before) * steps[k];
                    squares += steps[k] * steps[k];
                    steps[k] = share - before;
                }
            if (pass % EXTRAPOLATED == EXTRAPOLATED - 1 && most > STEADY_SHARE && alike > 0.0 && alike < squares)
                extrapolate_shares(i, rests, steps, alike / (squares - alike));
            settings_upload_parameters(i);
        }
        if (any && most > STEADY_SHARE)
            instance_warn(i, WARNED_OF_SHARES,
                "%s, t = %.6g s: shares of friction at rest change by %.1e > %.0e of their limits after %d rounds, so "
                "that joints may stick or slide wrongly; give joints with friction other limits, or fewer of them",
                s->name, *instance_time(i), most, STEADY_SHARE, SHARING_ROUNDS);
        settled = IDLER * idle;
        if (!let_one_slide(i, rests, idle) && !bring_one_to_rest(i, rests, began, idle))
            break;
    }
    bring_to_rest(i, rests, began, settled);
    choose_sticking(i, rests);
    update_rows_in_force(i);
    release_unheld(i);
    arena_release(i, arena);
    return DONE;
}

/* Make joints stick or slide according to the load, and set the velocities of joints that begin to stick to zero.
   Joints with `stopped` have come to rest; NULL judges all joints by their rates. */
Outcome friction_event(Instance *i, const unsigned char *stopped)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    const int count = s->frictions, brakes = i->flags.brakes;
    double *q = instance_field(i, s->z), *v = q + s->n, *rates = arena_alloc(i, (size_t)count),
           *before = arena_alloc(i, (size_t)count);
    unsigned char *rests = (unsigned char *)arena_alloc(i, (size_t)count);
    int changed = 0;
    Outcome outcome;
    friction_rates(i, rates);
    for (int k = 0; k < count; k++) {
        before[k] = *friction_slip(i, k);
        rests[k] = (stopped && stopped[k]) || !(fabs(rates[k]) > friction_rest(i));
        if (!rests[k])
            *friction_slip(i, k) = rates[k] > 0.0 ? 1.0 : -1.0;
    }
    outcome = decide_sticking(i, rests);
    for (int k = 0; k < count; k++)
        changed |= (before[k] == 0.0) != (*friction_slip(i, k) == 0.0);
    if (outcome == DONE && friction_count_sticking(i))
        outcome = projection_apply(i, q, v);
    if (outcome == DONE && changed) {
        outcome = settings_update_rank(i, q, v);
        if (outcome == RANK_CHANGES) /* Sticking joints may be redundant at rest, if the scene has no brakes. */
            outcome = DONE;
        i->flags.brakes = brakes;
    }
    if (outcome == DONE)
        settings_upload(i);
    /* The data that the integrator keeps between steps are invalid here. */
    instance_field(i, s->pace)[PACE_LAST] = 0.0;
    i->flags.known = 0;
    arena_release(i, arena);
    return outcome;
}

/* Decide again which joints stick if the state of a joint disagrees with its rate or its load, as after a change of
   inputs. */
Outcome friction_checked(Instance *i)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    const int count = s->frictions;
    double *rates = arena_alloc(i, (size_t)count);
    const double *grip;
    int wrong = 0;
    friction_rates(i, rates);
    for (int k = 0; k < count; k++)
        wrong |= fabs(*friction_slip(i, k)) == 1.0 ? *friction_slip(i, k) * rates[k] <= friction_rest(i)
                                                   : fabs(rates[k]) > friction_rest(i) || !friction_count_sticking(i);
    if (!wrong && friction_count_sticking(i)) {
        grip = friction_gripped(i);
        for (int k = 0; k < count; k++)
            wrong |= *friction_slip(i, k) == 0.0 && !(fabs(grip[k]) <= (1.0 + EXCEEDED) * grip[count + k]);
    }
    arena_release(i, arena);
    return wrong ? friction_event(i, NULL) : DONE;
}

/* Return whether the constraints in force depend on each other at regular positions, while no joint sticks. */
static int are_redundant(const Instance *i)
{
    int held = 0;
    for (int r = 0; r < i->scene->l; r++)
        held += i->penalty[r] > 0.0;
    return held > (int)*i->rank;
}

/* Decide which joints stick at the start of a run, or after constraints were switched. No joint sticks before. */
Outcome friction_begin(Instance *i)
{
    const Scene *s = i->scene;
    char names[300] = "";
    const int unsettled = are_redundant(i) && !(s->compliances && i->compliances[0] > 0.0);
    int switched = 0;
    if (!s->frictions)
        return DONE;
    for (int k = 0; k < s->frictions; k++)
        if (unsettled && s->friction[k].shared)
            append_name(i, k, names, sizeof names);
    for (int k = 0; k < s->switches; k++)
        switched |= i->requested[k] != s->switched[k].start;
    if (unsettled && switched && !*names)
        instance_warn(i, WARNED_OF_FRICTION,
            "%s, t = %.6g s: switching a lock, joint or motion has made constraints redundant; where they share the "
            "load of joints with dry friction, it is not unique, and the least loads are taken; give compliances of "
            "constraints (--compliances) to settle it",
            s->name, *instance_time(i));
    if (*names)
        instance_warn(i, WARNED_OF_FRICTION,
            "%s: redundant constraints share the load of %s, so that its friction and the motion are not unique, and "
            "the least loads are taken; give compliances of constraints (--compliances) to settle it",
            s->name, names);
    return s->gripping < 0 ? DONE : friction_event(i, NULL); /* A scene for the start alone has no programs. */
}
