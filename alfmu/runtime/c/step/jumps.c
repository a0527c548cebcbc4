/* Find jumps and non-finite values of laws of time in each communication step before it is made.

   A Gauss rule compares the change of a law over an interval with the integral of its rate; if they differ, both
   halves are searched. Smooth laws and kinks agree once the interval is short enough; jumps never do. Rates are
   compared with their own rates in the same way: a jump of a rate is an impact. Coordinates in a law continue at
   constant velocity. */

#include "jumps.h"

#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "message.h"
#include "scene.h"

/* Most bisections of a step, down to the resolution of any time in double precision. */
#define JUMP_DEPTH 64

/* Length of an instant, in seconds or relative to the time: a law that changes within it jumps. */
#define INSTANT 1e-12

/* Window before a jump, in units of INSTANT; a third of it follows the jump. No point of the Gauss rule is close to
   a jump at the time itself. */
#define ABOUT 8

/* Laws, their rates, and their second rates. */
enum { LAW, RATE, ORDERS = 3 };

#define JUMP_POINTS 3
static const double jump_points[JUMP_POINTS] = {0.1127016653792583, 0.5, 0.8872983346207417};
static const double jump_weights[JUMP_POINTS] = {5.0 / 18, 8.0 / 18, 5.0 / 18};

/* A break of a law: the size of its jump, or a value that is not finite. */
typedef struct {
    int law;
    double size, time;
} Break;

size_t laws_room(const Scene *s)
{
    return s->leap_count ? (size_t)s->n + 3 * ORDERS * (size_t)s->leap_count : 0;
}

static void evaluate_laws(Instance *i, double time, double *found)
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

static int is_in_force(const Instance *i, int law)
{
    const int row = i->scene->leaps[law].row;
    return row < 0 || i->penalty[row] > 0.0;
}

/* Return the law whose change over an interval differs most from the integral of its rate, relative to the limit,
   for the orders `first` to `last` (laws, rates); -1 if none exceeds it. */
static int find_mismatch(Instance *i, double a, double b, int first, int last, double *size)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), count = (size_t)s->leap_count, begin = (size_t)first * count,
                 end = (size_t)(last + 1) * count;
    double *change = arena_alloc(i, ORDERS * count), *now = arena_alloc(i, ORDERS * count),
           *limit = arena_alloc(i, ORDERS * count), worst = 1.0;
    int found = -1;
    evaluate_laws(i, b, change);
    evaluate_laws(i, a, now);
    for (size_t k = begin; k < end; k++) {
        limit[k] = JUMP * (1.0 + fmax(fabs(now[k]), fabs(change[k])));
        change[k] -= now[k];
    }
    for (int each = 0; each < JUMP_POINTS; each++) {
        evaluate_laws(i, a + jump_points[each] * (b - a), now);
        for (size_t k = begin; k < end; k++)
            change[k] -= jump_weights[each] * (b - a) * now[k + count];
    }
    for (size_t k = begin; k < end; k++) {
        const double over = isfinite(change[k]) ? fabs(change[k]) / limit[k] : INFINITY;
        if (over > worst && is_in_force(i, (int)(k % count))) {
            worst = over;
            found = (int)(k % count);
            *size = fabs(change[k]);
        }
    }
    arena_release(i, arena);
    return found;
}

/* Find the first break of laws or rates between two times. Return 0 if there is none, -1 if the search takes too
   long. */
static int find_first_break(Instance *i, double begin, double end, int order, Break *found)
{
    double ends[JUMP_DEPTH] = {end}, a = begin;
    int top = 0;
    for (long left = MOST_STEPS; top >= 0; left--) {
        const double b = ends[top], instant = INSTANT * fmax(1.0, fmax(fabs(a), fabs(b)));
        found->law = find_mismatch(i, a, b, order, order, &found->size);
        if (found->law < 0) {
            a = b;
            top--;
        } else if (b - a <= instant || top + 1 == JUMP_DEPTH) {
            if (isfinite(found->size)) {
                const int law
                    = find_mismatch(i, a - ABOUT * instant, b + 3 * ABOUT * instant, order, order, &found->size);
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

/* Check the laws between two times. */
static Outcome check_laws(Instance *i, double begin, double end)
{
    const Scene *s = i->scene;
    const Leap *law;
    Break found;
    int breaks;
    if (find_mismatch(i, begin, end, LAW, RATE, &found.size) < 0)
        return DONE;
    breaks = find_first_break(i, begin, end, LAW, &found);
    law = s->leaps + (breaks ? found.law : 0);
    if (breaks < 0)
        return instance_say(i, FAILED,
            "%s, t = %.6g s: %s changes too often to be searched for jumps up to %.6g s; take shorter communication "
            "steps",
            s->name, found.time, law->what, end);
    if (breaks && isfinite(found.size))
        return instance_say(i, NO_STEP_ON, JUMPS, s->name, law->what, found.size, law->unit, found.time);
    if (!breaks && !(i->flags.warned & WARNED_OF_CORNER) && find_first_break(i, begin, end, RATE, &found) > 0) {
        law = s->leaps + found.law;
        breaks = !isfinite(found.size);
        if (!breaks)
            instance_warn(i, WARNED_OF_CORNER, IMPACT, s->name, law->what, found.size, law->rate_unit, found.time);
    }
    return breaks ? say_broken(i, NO_STEP_ON, found.law, found.time) : DONE;
}

/* Return DONE if no law in force breaks up to an end, or the reason why no step leads there; warn of rates that
   jump. */
Outcome laws_checked(Instance *i, double end)
{
    double from = *instance_time(i);
    Outcome outcome = DONE;
    if (!i->scene->leap_count)
        return DONE;
    for (int k = 0; k < 2 * i->broken && outcome == DONE; k++)
        if (i->breaks[k] > from && i->breaks[k] < end) {
            outcome = check_laws(i, from, i->breaks[k]);
            from = i->breaks[k];
        }
    return outcome == DONE ? check_laws(i, from, end) : outcome;
}

/* Check that the laws are finite at the start; report a law that is not, instead of a failed start. Positions are those
   of the start, or the guess if the start failed. */
Outcome laws_begun(Instance *i, Outcome outcome)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), count = (size_t)s->leap_count;
    const double time = *instance_time(i), *start = i->values + s->own,
                 *x[] = {instance_field(i, s->p), start, start + s->starts};
    double *y[] = {instance_field(i, s->z), instance_field(i, s->z) + s->n}, *found;
    if (!count)
        return outcome;
    if (outcome != DONE)
        function_call(i, s->guesses, x, y);
    found = arena_alloc(i, ORDERS * count);
    evaluate_laws(i, time, found);
    for (size_t k = 0; k < ORDERS * count; k++)
        if (!isfinite(found[k]) && is_in_force(i, (int)(k % count)))
            outcome = say_broken(i, FAILED, (int)(k % count), time);
    arena_release(i, arena);
    return outcome;
}
