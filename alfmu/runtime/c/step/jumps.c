/* Laws of time that may jump, or not be finite: looked at over each communication step before it is made.

   Between two times the change of a law is compared with what its rate makes of it, by a rule of Gauss; where they differ,
   both halves are looked at. Smooth laws agree sooner or later, however steep they are, and kinks of them do; a jump stays.
   Rates are compared with their own rates in the same way: where they jump, there is an impact. Coordinates in a law go on
   evenly from where they are. */

#include "jumps.h"

#include <math.h>
#include <stddef.h>

#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "message.h"
#include "scene.h"

/* Halves of halves of a step: down to an instant of any time that a double can have. */
#define JUMP_DEPTH 64

/* Length of an instant [s, or of the time itself]: a law that changes within it jumps. */
#define INSTANT 1e-12

/* Length of what is looked at before a jump, over an instant, and a third of that behind it: times that a jump falls on have
   half of it on either side, and no point of the rule is near it. */
#define ABOUT 8

/* Laws, their rates, and the rates of these. */
enum { LAW, RATE, ORDERS = 3 };

#define JUMP_POINTS 3
static const double jump_points[JUMP_POINTS] = {0.1127016653792583, 0.5, 0.8872983346207417};
static const double jump_weights[JUMP_POINTS] = {5.0 / 18, 8.0 / 18, 5.0 / 18};

/* Where a law breaks: how much it jumps by, or no finite number. */
typedef struct {
    int law;
    double size, time;
} Break;

size_t laws_room(const Scene *s)
{
    return s->leap_count ? (size_t)s->n + 3 * ORDERS * (size_t)s->leap_count : 0;
}

static void laws_at(Instance *i, double time, double *found)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    const double *now = instance_field(i, s->z), *v = now + s->n;
    double *q = arena_alloc(i, (size_t)s->n), *y[] = {found};
    const double *x[] = {q, v, instance_field(i, s->p)};
    for (int c = 0; c < s->n; c++)
        q[c] = now[c] + (time - *instance_time(i)) * v[c];
    q[s->n - 1] = time;
    function_call(i, s->laws, x, y);
    arena_release(i, arena);
}

static int counts(const Instance *i, int law)
{
    const int row = i->scene->leaps[law].row;
    return row < 0 || i->penalty[row] > 0.0;
}

/* The law whose change between two times differs most from what rates make of it, over the limit, of orders from the first to
   the last: of laws, of their rates; -1 where none does by more than that. */
static int apart(Instance *i, double a, double b, int first, int last, double *size)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), count = (size_t)s->leap_count, begin = (size_t)first * count, end = (size_t)(last + 1) * count;
    double *change = arena_alloc(i, ORDERS * count), *now = arena_alloc(i, ORDERS * count), *limit = arena_alloc(i, ORDERS * count), worst = 1.0;
    int found = -1;
    laws_at(i, b, change);
    laws_at(i, a, now);
    for (size_t k = begin; k < end; k++) {
        limit[k] = JUMP * (1.0 + fmax(fabs(now[k]), fabs(change[k])));
        change[k] -= now[k];
    }
    for (int each = 0; each < JUMP_POINTS; each++) {
        laws_at(i, a + jump_points[each] * (b - a), now);
        for (size_t k = begin; k < end; k++)
            change[k] -= jump_weights[each] * (b - a) * now[k + count];
    }
    for (size_t k = begin; k < end; k++) {
        const double over = isfinite(change[k]) ? fabs(change[k]) / limit[k] : INFINITY;
        if (over > worst && counts(i, (int)(k % count))) {
            worst = over;
            found = (int)(k % count);
            *size = fabs(change[k]);
        }
    }
    arena_release(i, arena);
    return found;
}

/* The first break between two times, of laws or of their rates; 0 where there is none, -1 where there is too much to look
   at. */
static int first_break(Instance *i, double begin, double end, int order, Break *found)
{
    double ends[JUMP_DEPTH] = {end}, a = begin;
    int top = 0;
    for (long left = MOST_STEPS; top >= 0; left--) {
        const double b = ends[top], instant = INSTANT * fmax(1.0, fmax(fabs(a), fabs(b)));
        found->law = apart(i, a, b, order, order, &found->size);
        if (found->law < 0) {
            a = b;
            top--;
        } else if (b - a <= instant || top + 1 == JUMP_DEPTH) {
            if (isfinite(found->size)) {
                const int law = apart(i, a - ABOUT * instant, b + 3 * ABOUT * instant, order, order, &found->size);
                found->law = law < 0 ? found->law : law;
            }
            found->time = b;
            return 1;
        } else if (left <= 0) {
            found->time = a;
            return -1;
        } else
            ends[++top] = a + (b - a) / 2;
    }
    return 0;
}

static Outcome say_broken(Instance *i, Outcome outcome, int law, double time)
{
    return instance_say(i, outcome, BROKEN, i->scene->name, time, i->scene->leaps[law].what);
}

/* The same between two times. */
static Outcome checked(Instance *i, double begin, double end)
{
    const Scene *s = i->scene;
    const Leap *law;
    Break found;
    int breaks;
    if (apart(i, begin, end, LAW, RATE, &found.size) < 0)
        return DONE;
    breaks = first_break(i, begin, end, LAW, &found);
    law = s->leaps + (breaks ? found.law : 0);
    if (breaks < 0)
        return instance_say(i, FAILED,
            "%s, t = %.6g s: %s changes too often to be looked at for jumps up to %.6g s; take shorter communication steps",
            s->name, found.time, law->what, end);
    if (breaks && isfinite(found.size))
        return instance_say(i, NO_STEP_ON, JUMPS, s->name, law->what, found.size, law->unit, found.time);
    if (!breaks && !(i->flags.warned & WARNED_OF_CORNER) && first_break(i, begin, end, RATE, &found) > 0) {
        law = s->leaps + found.law;
        breaks = !isfinite(found.size);
        if (!breaks)
            instance_warn(i, WARNED_OF_CORNER, IMPACT, s->name, law->what, found.size, law->rate_unit, found.time);
    }
    return breaks ? say_broken(i, NO_STEP_ON, found.law, found.time) : DONE;
}

/* DONE where no law in force breaks from now to an end, or why no step leads there; a rate that jumps is warned of. */
Outcome laws_checked(Instance *i, double end)
{
    double from = *instance_time(i);
    Outcome outcome = DONE;
    if (!i->scene->leap_count)
        return DONE;
    for (int k = 0; k < 2 * i->broken && outcome == DONE; k++)
        if (i->breaks[k] > from && i->breaks[k] < end) {
            outcome = checked(i, from, i->breaks[k]);
            from = i->breaks[k];
        }
    return outcome == DONE ? checked(i, from, end) : outcome;
}

/* What a start came to; where a law is not finite then, that it is not. Places are those of the start, or the guess where
   there is none. */
Outcome laws_begun(Instance *i, Outcome outcome)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), count = (size_t)s->leap_count;
    const double time = *instance_time(i), *start = i->values + s->own, *x[] = {instance_field(i, s->p), start, start + s->starts};
    double *y[] = {instance_field(i, s->z), instance_field(i, s->z) + s->n}, *found;
    if (!count)
        return outcome;
    if (outcome != DONE)
        function_call(i, s->guesses, x, y);
    found = arena_alloc(i, ORDERS * count);
    laws_at(i, time, found);
    for (size_t k = 0; k < ORDERS * count; k++)
        if (!isfinite(found[k]) && counts(i, (int)(k % count)))
            outcome = say_broken(i, FAILED, (int)(k % count), time);
    arena_release(i, arena);
    return outcome;
}
