/* Dry friction that follows from the load: when joints stick and slide, and steps up to these events.

   While a joint slides, its direction s is 1 or -1 and accelerations contain its friction; while it sticks, s is 0 and the
   constraint of the joint is in force. What changes s is an event: the rate of a joint that slides goes through zero, or
   the multiplier of one that sticks exceeds its limit. A step over an event is taken back and made again up to it.

   As many joints stick as there are motions to hold; others at rest are held by them, at their limit (LIMITED) or with a
   share of it (SHARED). */

#include "alfmu.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

static double *slip(const Instance *i, int k)
{
    return i->kept + i->scene->friction[k].slip;
}

static int sticks(const Instance *i)
{
    int count = 0;
    for (int k = 0; k < i->scene->frictions; k++)
        count += *slip(i, k) == 0.0;
    return count;
}

/* Before anything is known, and before an impact: no joint sticks. */
void friction_reset(Instance *i)
{
    for (int k = 0; k < i->scene->frictions; k++)
        *slip(i, k) = 1.0;
}

static void rates_at(Instance *i, double *rates)
{
    const Scene *s = i->scene;
    const double *z = field(i, s->z), *x[] = {z, z + s->n, field(i, s->p)};
    double *y[] = {rates};
    call(i, s->sliding, x, y);
}

/* What `gripping` gives: multipliers, limits, second rates; what is left of the laws, the least pivot. */
static const double *gripped(Instance *i)
{
    run(i, i->scene->gripping);
    return i->workspace + i->scene->grip;
}

/* Whether laws of friction have no solution here, or are about to have none. */
int jammed(Instance *i)
{
    const Scene *s = i->scene;
    const double *grip;
    if (!s->frictions || s->gripping < 0)
        return 0;
    grip = gripped(i) + 3 * s->frictions;
    return !(grip[0] <= JAM_SETTLED * JAM_SETTLED) || !(grip[1] > JAM_PIVOT);
}

/* The name of a joint behind others. */
static void list(const Instance *i, int k, char *names, size_t size)
{
    const Scene *s = i->scene;
    char part[64];
    snprintf(part, sizeof part, "%s%.40s", *names ? ", " : "", s->rows[s->friction[k].row].name);
    strncat(names, part, size - strlen(names) - 1);
}

Outcome say_jam(Instance *i)
{
    const Scene *s = i->scene;
    char names[300] = "";
    for (int k = 0; k < s->frictions; k++)
        if (fabs(*slip(i, k)) == 1.0 || *slip(i, k) == SHARED)
            list(i, k, names, sizeof names);
    return say(i, FAILED,
        "%s, t = %.6g s: a jam: no sliding motion has friction as large as its load (%s)%s; the load grows with its own "
        "friction without bound: take smaller coefficients of friction, smaller radii or a longer guide",
        s->name, *instance_time(i), names, s->timed ? ", and a law of time asks for one" : "");
}

/* Constraints of joints that stick put in force, and those of others not. */
static void take_hold(Instance *i)
{
    const Scene *s = i->scene;
    for (int k = 0; k < s->frictions; k++) {
        const int row = s->friction[k].row;
        i->penalty[row] = *slip(i, k) == 0.0 ? i->full[row] : 0.0;
    }
    parameters(i);
    weigh(i);
}

/* Where a joint sticks from now on. */
static void stick(Instance *i, int k)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *displacements = take(i, (size_t)s->held);
    const double *x[] = {field(i, s->z), field(i, s->p)};
    double *y[] = {displacements};
    call(i, s->displacements, x, y);
    i->kept[s->friction[k].value] = displacements[s->friction[k].value];
    *slip(i, k) = 0.0;
    i->used = used;
}

/* The second rate of a joint at rest that holds with a share of its limit; below zero beyond a jam, where no load is enough
   for the friction that it makes. */
static double second_rate(Instance *i, int k, double share)
{
    const int count = i->scene->frictions;
    const double *grip;
    i->kept[i->scene->friction[k].value] = share;
    parameters(i);
    grip = gripped(i);
    if (!(grip[3 * count] <= JAM_SETTLED * JAM_SETTLED && grip[3 * count + 1] > 0.0))
        return NAN;
    return grip[2 * count + k];
}

/* The share of its limit that holds a joint at rest, others being as they are: 1 or -1 where that is not enough. */
static double holding_share(Instance *i, int k, double share, double idle)
{
    double now = second_rate(i, k, share), low, high, at_low, at_high;
    const double way = now > 0.0 ? 1.0 : -1.0;
    if (isnan(now))
        return 0.0;
    if (fabs(now) <= idle)
        return share;
    if (share == way)
        return share;
    at_high = way * second_rate(i, k, way);
    if (at_high >= 0.0)
        return way;
    low = way * share, high = 1.0, at_low = way * now;
    for (int pass = 0; pass < SEARCHED && high - low > 4 * DBL_EPSILON; pass++) {
        /* Beyond a jam nothing is known but the direction. */
        const double at = isnan(at_high) || pass % 4 == 3 ? (low + high) / 2 : low + (high - low) * at_low / (at_low - at_high);
        now = way * second_rate(i, k, way * at);
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
    second_rate(i, k, way * low);
    return way * low;
}

/* The joint at rest that moves most in spite of all of its limit slides from now on; 0 where there is none. */
static int one_slides(Instance *i, unsigned char *rests, double idle)
{
    const Scene *s = i->scene;
    const int count = s->frictions;
    const double *seconds = gripped(i) + 2 * count;
    double most = idle;
    int which = -1;
    for (int k = 0; k < count; k++) {
        const double share = i->kept[s->friction[k].value];
        if (rests[k] && fabs(share) == 1.0 && share * seconds[k] > most) {
            most = share * seconds[k];
            which = k;
        }
    }
    if (which < 0)
        return 0;
    *slip(i, which) = i->kept[s->friction[which].value];
    rests[which] = 0;
    return 1;
}

/* A joint that began to slide, and does not as others slide too, is at rest again; 0 where there is none. */
static int one_rests(Instance *i, unsigned char *rests, unsigned char *began, double idle)
{
    const int count = i->scene->frictions;
    const double *seconds = gripped(i) + 2 * count;
    for (int k = 0; k < count; k++)
        if (began[k] && !rests[k] && *slip(i, k) * seconds[k] < -idle) {
            rests[k] = 1;
            began[k] = 0; /* Once. */
            return 1;
        }
    return 0;
}

/* Joints that began to slide and do not move, as others hold them then, are at rest with the share that they have. */
static void come_to_rest(Instance *i, unsigned char *rests, const unsigned char *began, double idle)
{
    const Scene *s = i->scene;
    const int count = s->frictions;
    const double *grip = gripped(i);
    for (int k = 0; k < count; k++)
        if (began[k] && !rests[k] && fabs(grip[2 * count + k]) <= idle) {
            rests[k] = 1;
            *slip(i, k) = SHARED;
            i->kept[s->friction[k].value] = fmin(fmax(grip[k] / (grip[count + k] + DBL_MIN), -1.0), 1.0);
        }
    parameters(i);
}

/* Of joints at rest with these shares of their limits as many stick as there are motions to hold, those with most room first;
   others are held by them. */
static void hold_still(Instance *i, const unsigned char *rests)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    const int count = s->frictions;
    const double *q = field(i, s->z);
    unsigned char *held = (unsigned char *)take(i, (size_t)s->l), *seen = (unsigned char *)take(i, (size_t)count);
    double *room = take(i, (size_t)count);
    int rank;
    memcpy(room, gripped(i) + count, (size_t)count * sizeof *room);
    for (int r = 0; r < s->l; r++)
        held[r] = i->penalty[r] > 0.0;
    for (int k = 0; k < count; k++) {
        const double share = i->kept[s->friction[k].value];
        seen[k] = !rests[k] || fabs(share) > 1.0 - NO_ROOM;
        room[k] *= 1.0 - fabs(share);
        if (rests[k] && seen[k])
            *slip(i, k) = share > 0.0 ? LIMITED : -LIMITED;
    }
    rank = rank_here(i, q, held);
    for (;;) {
        int which = -1, more;
        for (int k = 0; k < count; k++)
            if (!seen[k] && (which < 0 || room[k] > room[which]))
                which = k;
        if (which < 0)
            break;
        seen[which] = 1;
        held[s->friction[which].row] = 1;
        more = rank_here(i, q, held);
        if (more > rank) {
            rank = more;
            stick(i, which);
        } else
            held[s->friction[which].row] = 0;
    }
    i->used = used;
}

/* Joints at their limit that nothing holds, and that begin to move, slide. */
static void let_go(Instance *i)
{
    const Scene *s = i->scene;
    const int count = s->frictions;
    const double *seconds = gripped(i) + 2 * count;
    double most = 1.0;
    for (int k = 0; k < count; k++)
        most = fmax(most, fabs(seconds[k]));
    for (int k = 0; k < count; k++)
        if (fabs(*slip(i, k)) == LIMITED && *slip(i, k) * seconds[k] > IDLE * most)
            *slip(i, k) /= LIMITED;
    parameters(i);
}

/* Which joints at rest stick, and where the others go: each in turn takes the share of its limit that holds it, until none
   moves but by all of its limit. Friction opposes motion, so that this ends: what one takes others need not. The joint that
   moves most then slides, and the others are asked again. */
static Outcome decide(Instance *i, unsigned char *rests)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    const int count = s->frictions;
    unsigned char *began = (unsigned char *)take(i, (size_t)count);
    double settled = 0.0;
    memcpy(began, rests, (size_t)count);
    for (int again = 0; again <= SLIDING_ROUNDS * count; again++) {
        double idle = IDLE;
        int moves = 1, any = 0;
        for (int k = 0; k < count; k++)
            if (rests[k]) {
                *slip(i, k) = SHARED;
                i->kept[s->friction[k].value] = 0.0;
                any = 1;
            }
        take_hold(i);
        if (jammed(i)) {
            i->used = used;
            return say_jam(i);
        }
        for (int k = 0; k < count; k++)
            idle = fmax(idle, IDLE * fabs((i->workspace + s->grip)[2 * count + k]));
        for (int pass = 0; any && moves && pass < SHARING_ROUNDS; pass++) {
            moves = 0;
            for (int k = 0; k < count; k++)
                if (rests[k]) {
                    const double before = i->kept[s->friction[k].value], share = holding_share(i, k, before, idle);
                    moves |= fabs(share - before) > STEADY_SHARE;
                    i->kept[s->friction[k].value] = share;
                }
            parameters(i);
        }
        settled = IDLER * idle;
        if (!one_slides(i, rests, idle) && !one_rests(i, rests, began, idle))
            break;
    }
    come_to_rest(i, rests, began, settled);
    hold_still(i, rests);
    take_hold(i);
    let_go(i);
    i->used = used;
    return DONE;
}

/* Joints put at rest or let go as the load wants it; velocities of those that stick from now on vanish. Those with `stopped`
   have come to rest, others where their rate says so. */
static Outcome friction_event(Instance *i, const unsigned char *stopped)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    const int count = s->frictions, brakes = i->flags.brakes;
    double *q = field(i, s->z), *v = q + s->n, *rates = take(i, (size_t)count), *before = take(i, (size_t)count);
    unsigned char *rests = (unsigned char *)take(i, (size_t)count);
    int changed = 0;
    Outcome outcome;
    rates_at(i, rates);
    for (int k = 0; k < count; k++) {
        before[k] = *slip(i, k);
        rests[k] = (stopped && stopped[k]) || !(fabs(rates[k]) > REST);
        if (!rests[k])
            *slip(i, k) = rates[k] > 0.0 ? 1.0 : -1.0;
    }
    outcome = decide(i, rests);
    for (int k = 0; k < count; k++)
        changed |= (before[k] == 0.0) != (*slip(i, k) == 0.0);
    if (outcome == DONE && sticks(i))
        outcome = projected(i, q, v);
    if (outcome == DONE && changed) {
        outcome = knowledge(i, q, v);
        if (outcome == BRAKES) /* What sticks beside others is redundant at rest, where nothing brakes. */
            outcome = DONE;
        i->flags.brakes = brakes;
    }
    if (outcome == DONE)
        settle_kernel(i);
    field(i, s->pace)[PACE_LAST] = 0.0; /* What the method keeps from step to step does not lead on from here. */
    i->flags.known = 0;
    i->used = used;
    return outcome;
}

/* Whether what joints do agrees with how they move and with what they carry; `inputs` have changed, too. */
static Outcome friction_checked(Instance *i)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    const int count = s->frictions;
    double *rates = take(i, (size_t)count);
    const double *grip;
    int wrong = 0;
    rates_at(i, rates);
    for (int k = 0; k < count; k++)
        wrong |= fabs(*slip(i, k)) == 1.0 ? *slip(i, k) * rates[k] <= REST : fabs(rates[k]) > REST || !sticks(i);
    if (!wrong && sticks(i)) {
        grip = gripped(i);
        for (int k = 0; k < count; k++)
            wrong |= *slip(i, k) == 0.0 && !(fabs(grip[k]) <= (1.0 + EXCEEDED) * grip[count + k]);
    }
    i->used = used;
    return wrong ? friction_event(i, NULL) : DONE;
}

/* Whether constraints in force depend on each other at regular positions, where no joint sticks. */
static int redundant(const Instance *i)
{
    int held = 0;
    for (int r = 0; r < i->scene->l; r++)
        held += i->penalty[r] > 0.0;
    return held > (int)*i->rank;
}

/* The start of a run, and where constraints have come into force or not; no joint sticks. */
Outcome friction_begin(Instance *i)
{
    const Scene *s = i->scene;
    char names[300] = "";
    const int unsettled = redundant(i) && !(s->compliances && i->compliances[0] > 0.0);
    int switched = 0;
    if (!s->frictions)
        return DONE;
    for (int k = 0; k < s->frictions; k++)
        if (unsettled && s->friction[k].shared)
            list(i, k, names, sizeof names);
    for (int k = 0; k < s->switches; k++)
        switched |= i->wanted[k] != s->switched[k].start;
    if (unsettled && switched && !*names)
        warn(i, WARNED_OF_FRICTION,
            "%s, t = %.6g s: with what is switched on or off constraints are redundant; where they share the load of joints "
            "with dry friction, it is not unique: the least loads are taken; give compliances of constraints "
            "(--compliances) to settle it",
            s->name, *instance_time(i));
    if (*names)
        warn(i, WARNED_OF_FRICTION,
            "%s: redundant constraints share the load of %s, so that its friction is not unique, and the motion is not "
            "either: the least loads are taken; give compliances of constraints (--compliances) to settle it",
            s->name, names);
    return s->gripping < 0 ? DONE : friction_event(i, NULL); /* A start alone has no programs. */
}

/* Events -------------------------------------------------------------------------------------------------------------- */

/* How far each joint is from its event, below zero beyond it: the rate in the direction in which it slides, the room of the
   multiplier where it sticks, over its limit, the rate that it lacks to move where others hold it. */
static void rooms(Instance *i, double *found)
{
    const Scene *s = i->scene;
    rates_at(i, found);
    if (sticks(i)) {
        const double *grip = gripped(i);
        for (int k = 0; k < s->frictions; k++)
            if (*slip(i, k) == 0.0)
                found[k] = 1.0 + EXCEEDED - fabs(grip[k]) / (grip[s->frictions + k] + DBL_MIN);
    }
    for (int k = 0; k < s->frictions; k++)
        if (fabs(*slip(i, k)) == 1.0)
            found[k] *= *slip(i, k);
        else if (*slip(i, k) != 0.0)
            found[k] = MOVING * REST - fabs(found[k]);
}

/* The least of those that meet an event in this step. */
static double least(const double *rooms, const unsigned char *meets, int count)
{
    double found = INFINITY;
    for (int k = 0; k < count; k++)
        if (meets[k] && !(rooms[k] >= found))
            found = rooms[k];
    return found;
}

/* Second rates in the direction in which joints slide. */
static void bends(Instance *i, double *found)
{
    const double *grip = gripped(i);
    for (int k = 0; k < i->scene->frictions; k++)
        found[k] = fabs(*slip(i, k)) == 1.0 ? *slip(i, k) * grip[2 * i->scene->frictions + k] : 0.0;
}

/* Whether the rate of a joint, by the cubic through both ends of a step of length h, goes through zero and back in it. */
static int dips(double before, double after, double bend_before, double bend_after, double h)
{
    const double slope = bend_before * h, end = bend_after * h, change = after - before;
    const double square = 3 * change - 2 * slope - end, cube = slope + end - 2 * change;
    if (!(slope < 0.0 && end > 0.0))
        return 0;
    for (int k = 1; k < SEEN_BETWEEN; k++) {
        const double x = (double)k / SEEN_BETWEEN;
        if (before + x * (slope + x * (square + x * cube)) < -REST)
            return 1;
    }
    return 0;
}

/* Whether a jam is here or within an internal step ahead, as where links are nearly aligned. */
static int jams_ahead(Instance *i)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    double *z = field(i, s->z), *kept = take(i, (size_t)s->n);
    int found = jammed(i);
    memcpy(kept, z, (size_t)s->n * sizeof *z);
    for (double ahead = i->values[s->step_size]; !found && ahead > JAM_AHEAD; ahead /= JAM_SHORTER) {
        for (int c = 0; c < s->n; c++)
            z[c] = kept[c] + ahead * z[s->n + c];
        found = jammed(i);
    }
    memcpy(z, kept, (size_t)s->n * sizeof *z);
    i->used = used;
    return found;
}

/* One step, or as many as it takes to the end where `all` says so; each is made by the method of the scene. */
static Outcome moved(Instance *i, double end, double dt, int all)
{
    double *time = instance_time(i);
    Outcome outcome = DONE;
    do {
        const double from = *time, left = end - from;
        const int last = left <= dt * (1 + ONE_STEP);
        if (ended(i) || method(i)) {
            outcome = covered(i, end, dt, 1);
        } else {
            const double step = last ? left : dt;
            outcome = plain_step(i, from, step);
            if (outcome == DONE)
                *time = last ? end : from + step;
        }
        if (outcome == DONE && i->left <= 0 && *time < end)
            outcome = covered(i, end, dt, 1);
    } while (all && outcome == DONE && *time < end);
    if (outcome != DONE && !i->ended && i->left > 0 && jams_ahead(i))
        return say_jam(i);
    return outcome;
}

typedef struct {
    double *state, *pace, *peaks; /* before the step */
    size_t size, count;
} Kept;

static void back_to(Instance *i, const Kept *kept)
{
    memcpy(field(i, i->scene->z), kept->state, kept->size);
    count_turns(i);
    memcpy(i->peaks, kept->peaks, peaks_length(i->scene) * sizeof *i->peaks);
    memcpy(field(i, i->scene->pace), kept->pace, kept->count * sizeof *kept->pace);
}

/* The step just made is taken back and made again up to the first event in it, which joints meet. */
static Outcome found_event(Instance *i, const Kept *kept, const double *before, const double *after,
    const unsigned char *meets, double dt)
{
    const Scene *s = i->scene;
    const size_t used = i->used;
    const int count = s->frictions;
    double *now = take(i, (size_t)count);
    const double start = kept->state[s->time];
    double low = start, high = *instance_time(i), at_low = least(before, meets, count), at_high = least(after, meets, count);
    double scale = fmax(fmax(fabs(at_low), fabs(at_high)), NEARLY_STOPPED * REST / STOPPED), weight_low = 1.0, weight_high = 1.0;
    double there = at_high;
    Outcome outcome = DONE;
    for (int pass = 0; pass < SEARCHED && outcome == DONE; pass++) {
        double t;
        if (fabs(there) <= STOPPED * scale || high - low <= 4 * DBL_EPSILON * fmax(fabs(high), EARLIEST))
            break;
        if (at_low <= 0.0) /* It has only begun to move: the event may be right here, or later. */
            t = low + (high - low) * RIGHT_THERE;
        else if (pass % 8 == 7)
            t = (low + high) / 2;
        else
            t = low + (high - low) * (weight_low * at_low) / (weight_low * at_low - weight_high * at_high);
        if (!(t > low && t < high))
            t = (low + high) / 2;
        back_to(i, kept);
        outcome = moved(i, t, dt, 1);
        if (outcome != DONE)
            break;
        rooms(i, now);
        there = least(now, meets, count);
        if (there < 0.0) {
            if (at_low <= 0.0) { /* It goes the wrong way from the begin on. */
                back_to(i, kept);
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
    i->used = used;
    return outcome;
}

/* Steps with dry friction up to the end of a communication step, internal ones of RK4 of length dt. */
Outcome friction_cover(Instance *i, double start, double h, double dt)
{
    const Scene *s = i->scene;
    const size_t used = i->used, count = (size_t)s->frictions, past = (size_t)(s->past + s->past_size - s->pace);
    const double end = start + h;
    double *time = instance_time(i), *before = take(i, count), *after = take(i, count);
    double *bend_before = take(i, count), *bend_after = take(i, count), within = INFINITY;
    const int looks = method(i) != 0; /* Steps of RK4 are as short as the user wants them. */
    unsigned char *meets = (unsigned char *)take(i, count);
    Kept kept = {take(i, state_length(s)), take(i, past), take(i, peaks_length(s)), state_length(s) * sizeof(double), past};
    int at_once = 0;
    Outcome outcome = friction_checked(i);
    while (outcome == DONE && *time < end) {
        const double from = *time;
        double limit = end;
        int any = 0;
        /* What a joint that sticks carries is looked at as often as that. */
        if (sticks(i) && end - from > i->values[s->step_size] * (1 + ONE_STEP))
            limit = from + i->values[s->step_size];
        limit = fmin(limit, from + within);
        within = INFINITY;
        memcpy(kept.state, field(i, s->z), kept.size);
        memcpy(kept.pace, field(i, s->pace), past * sizeof(double));
        memcpy(kept.peaks, i->peaks, peaks_length(s) * sizeof(double));
        rooms(i, before);
        if (looks && sticks(i) < (int)count)
            bends(i, bend_before);
        outcome = moved(i, limit, dt, 0);
        if (outcome != DONE)
            break;
        rooms(i, after);
        for (size_t k = 0; k < count; k++) {
            meets[k] = !(after[k] >= (fabs(*slip(i, (int)k)) == 1.0 ? -REST : 0.0));
            any |= meets[k];
        }
        if (!any && looks && sticks(i) < (int)count && *time - from > LOOKED_INTO) {
            bends(i, bend_after);
            for (size_t k = 0; k < count; k++)
                if (fabs(*slip(i, (int)k)) == 1.0 && dips(before[k], after[k], bend_before[k], bend_after[k], *time - from))
                    within = (*time - from) / 2;
            if (within < INFINITY) { /* Made again in halves. */
                back_to(i, &kept);
                continue;
            }
        }
        if (!any) {
            at_once = 0;
            continue;
        }
        outcome = found_event(i, &kept, before, after, meets, dt);
        if (outcome != DONE)
            break;
        rooms(i, after);
        {
            const double first = least(after, meets, (int)count);
            for (size_t k = 0; k < count; k++)
                meets[k] = meets[k] && fabs(*slip(i, (int)k)) == 1.0 && after[k] <= fmax(fabs(first), REST);
        }
        at_once = *time > from ? 0 : at_once + 1;
        if (at_once == AT_ONCE)
            outcome = say(i, FAILED,
                "%s, t = %.6g s: joints with dry friction neither stick nor slide here in a way that agrees with their "
                "loads; change coefficients of friction a little",
                s->name, *time);
        else
            outcome = friction_event(i, meets);
    }
    i->used = used;
    return outcome;
}
