/* Find the times in a communication step at which forces, laws of motion or rates of states jump or have a kink, so
   that internal steps can end there. The kernel provides a smooth switching function for each.

   If a cubic through both ends of an interval fits the functions, it counts their changes of sign; otherwise both
   halves are searched. A function that depends on a break of another one is searched between the breaks of that one,
   level by level. */

#include "breaks.h"

#include "inputs.h"
#include "instance.h"
#include "interpret.h"
#include "message.h"
#include "scene.h"

/* Most bisections of a step. */
#define DEPTH 48

/* Relative deviation from a cubic below which the cubic is accepted. */
#define EXPLAINED 1e-4

/* An extremum below this share of the largest value is searched for a double change of sign. */
#define TOUCHING 0.01

/* Width of a change of sign, in units of the last digit of the time. */
#define DIGITS 4

/* Most doublings of that width, for functions that are zero on both sides of a change of sign. */
#define FLAT 24

/* Most secant steps; no change of sign of finite numbers needs as many. */
#define MOST_PASSES 300

/* Number of points at which cubics are compared, none of them at a simple fraction of the interval, so that waves
   are not missed. */
#define POINTS 3
static const double points[POINTS] = {0.1127016653792583, 0.4393201, 0.8172983346207417};

size_t breaks_room(const Scene *s)
{
    return s->break_count ? (size_t)(2 * s->inputs + DEPTH) + (size_t)(8 + 2 * DEPTH) * (size_t)s->break_count : 0;
}

/* Evaluate the switching functions, followed by their rates. */
static void evaluate_breaks(Instance *i, double time, double *found)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *u = arena_alloc(i, (size_t)s->inputs), *du = arena_alloc(i, (size_t)s->inputs), *y[] = {found};
    const double *x[] = {&time, u, du, instance_field(i, s->p)};
    inputs_within(i, *instance_time(i), time, u, du);
    function_call(i, s->breaks, x, y);
    arena_release(i, arena);
}

static double time_resolution(double time)
{
    return DIGITS * DBL_EPSILON * fmax(fabs(time), 1e-3);
}

/* Append a break. Return 0 if there is no room. */
static int append_break(Instance *i, double left, double right)
{
    if (i->broken == MOST_BREAKS)
        return 0;
    i->breaks[2 * i->broken] = left - time_resolution(left);
    i->breaks[2 * i->broken++ + 1] = right;
    return 1;
}

/* Two times with a change of sign of one function between them, and the function's values there. */
typedef struct {
    double low, high, at_low, at_high;
} Bracket;

/* Evaluate one function at a time within the bracket and move the end of the same sign there. */
static void shrink_bracket(Instance *i, int which, double time, Bracket *b)
{
    const size_t arena = arena_mark(i);
    double *now = arena_alloc(i, 2 * (size_t)i->scene->break_count);
    evaluate_breaks(i, time, now);
    if ((now[which] > 0.0) == (b->at_high > 0.0)) {
        b->high = time;
        b->at_high = now[which];
    } else {
        b->low = time;
        b->at_low = now[which];
    }
    arena_release(i, arena);
}

/* Return the first time after `time`, in the direction `way`, at which the function is not zero to the last digit, plus
   as much again, so that round-off no longer affects it. */
static double find_time_beyond(Instance *i, int which, double time, double way)
{
    const size_t arena = arena_mark(i);
    double *now = arena_alloc(i, 2 * (size_t)i->scene->break_count), step = time_resolution(time);
    double to = time;
    evaluate_breaks(i, to, now);
    for (int pass = 0; pass < FLAT && now[which] == 0.0; pass++, step *= 2) {
        to += way * step;
        evaluate_breaks(i, to, now);
    }
    arena_release(i, arena);
    return to + (to - time);
}

/* Narrow the bracket of a change of sign by secant steps, each with an evaluation just beyond it, and by bisections. */
static int narrow_bracket(Instance *i, int which, double low, double high, double at_low, double at_high)
{
    Bracket b = {low, high, at_low, at_high};
    for (int pass = 0; b.high - b.low > time_resolution(b.high); pass++) {
        const double near = time_resolution(b.high) / 2, low_before = b.low;
        double t = b.low + (b.high - b.low) * (pass % 3 == 2 ? 0.5 : b.at_low / (b.at_low - b.at_high));
        t = fmin(fmax(t, b.low + near), b.high - near); /* A NaN becomes the lower bound. */
        if (pass == MOST_PASSES)
            return 1; /* No sign change of finite numbers remains. */
        shrink_bracket(i, which, t, &b);
        t += b.low > low_before ? near : -near;
        if (t > b.low && t < b.high)
            shrink_bracket(i, which, t, &b);
    }
    return append_break(i, find_time_beyond(i, which, b.low, -1.0), find_time_beyond(i, which, b.high, 1.0));
}

/* The cubic through both ends of an interval. */
typedef struct {
    double value, slope, square, cube;
} Cubic;

static Cubic fit_cubic(double before, double after, double slope, double end)
{
    const double change = after - before;
    const Cubic c = {before, slope, 3 * change - 2 * slope - end, slope + end - 2 * change};
    return c;
}

static double evaluate_cubic(Cubic c, double x)
{
    return c.value + x * (c.slope + x * (c.square + x * c.cube));
}

/* Return the time of an extremum close to zero, or beyond zero, after a time; a negative number if there is none. */
static double find_turn(Cubic c, double after, double end)
{
    const double root = sqrt(fmax(c.square * c.square - 3 * c.cube * c.slope, 0.0));
    double x, there;
    if (!(c.value > 0.0 ? c.slope < 0.0 && end > 0.0 : c.slope > 0.0 && end < 0.0))
        return -1.0;
    x = -c.slope / (c.square + (c.slope < 0.0 ? root : -root));
    there = evaluate_cubic(c, x);
    if (!(x > 0.0 && x < 1.0)
        || ((there > 0.0) == (c.value > 0.0) && fabs(there) > TOUCHING * fmax(fabs(c.value), fabs(after))))
        return -1.0;
    return x;
}

/* Return whether cubics through both ends of an interval fit all functions of a level. */
static int is_smooth(Instance *i, int level, double a, double b, const double *first, const double *last)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), count = (size_t)s->break_count;
    double *now = arena_alloc(i, 2 * count);
    int all = 1;
    for (int each = 0; each < POINTS && all; each++) {
        evaluate_breaks(i, a + points[each] * (b - a), now);
        for (size_t k = 0; k < count; k++) {
            const double slope = (b - a) * first[count + k], end = (b - a) * last[count + k];
            const double off = now[k] - evaluate_cubic(fit_cubic(first[k], last[k], slope, end), points[each]);
            all &= s->break_levels[k] != level
                || !(fabs(off) > EXPLAINED * (fabs(first[k]) + fabs(last[k]) + fabs(slope) + fabs(end)));
        }
    }
    arena_release(i, arena);
    return all;
}

/* Find the changes of sign of a level between two times. Return 0 if there are too many. */
static int find_sign_changes(Instance *i, int level, double a, double b)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), count = (size_t)s->break_count;
    double *first = arena_alloc(i, 2 * count), *middle = arena_alloc(i, 2 * count), *ends = arena_alloc(i, DEPTH),
           *last[DEPTH];
    int top = 0, enough = 1;
    long left = MOST_STEPS;
    last[0] = arena_alloc(i, 2 * count);
    ends[0] = b;
    evaluate_breaks(i, a, first);
    evaluate_breaks(i, b, last[0]);
    while (top >= 0 && enough) {
        double *end = last[top];
        b = ends[top];
        if (top + 1 < DEPTH && b - a > 8 * time_resolution(b) && !is_smooth(i, level, a, b, first, end)) {
            if (--left < 0)
                enough = 0;
            ends[++top] = a + (b - a) / 2;
            last[top] = arena_alloc(i, 2 * count);
            evaluate_breaks(i, ends[top], last[top]);
            continue;
        }
        for (int k = 0; k < s->break_count && enough; k++) {
            double x, slope, stop;
            if (s->break_levels[k] != level || !(isfinite(first[k]) && isfinite(end[k])))
                continue;
            if ((first[k] > 0.0) != (end[k] > 0.0)) {
                enough = narrow_bracket(i, k, a, b, first[k], end[k]);
                continue;
            }
            slope = (b - a) * first[count + (size_t)k];
            stop = (b - a) * end[count + (size_t)k];
            x = find_turn(fit_cubic(first[k], end[k], slope, stop), end[k], stop);
            if (x < 0.0)
                continue;
            x = a + x * (b - a);
            evaluate_breaks(i, x, middle);
            if ((first[k] > 0.0) != (middle[k] > 0.0))
                enough
                    = narrow_bracket(i, k, a, x, first[k], middle[k]) && narrow_bracket(i, k, x, b, middle[k], end[k]);
        }
        memcpy(first, end, 2 * count * sizeof *first);
        a = b;
        top--;
        i->used -= 2 * count; /* Release the values of this end. */
    }
    arena_release(i, arena);
    return enough;
}

/* Sort the breaks and merge those that overlap. */
static void merge_breaks(Instance *i)
{
    double *x = i->breaks;
    int kept = 0;
    for (int k = 1; k < i->broken; k++) {
        const double left = x[2 * k], right = x[2 * k + 1];
        int j = k;
        for (; j > 0 && x[2 * j - 2] > left; j--)
            memcpy(x + 2 * j, x + 2 * j - 2, 2 * sizeof *x);
        x[2 * j] = left;
        x[2 * j + 1] = right;
    }
    for (int k = 0; k < i->broken; k++)
        if (kept && x[2 * k] <= x[2 * kept - 1])
            x[2 * kept - 1] = fmax(x[2 * kept - 1], x[2 * k + 1]);
        else {
            x[2 * kept] = x[2 * k];
            x[2 * kept++ + 1] = x[2 * k + 1];
        }
    i->broken = kept;
}

/* Find the breaks between two times, each as a pair of times just before and just after it. */
Outcome breaks_found(Instance *i, double begin, double end)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    int enough = 1, most = 0;
    i->broken = 0;
    if (!s->break_count)
        return DONE;
    for (int k = 0; k < s->break_count; k++)
        most = s->break_levels[k] > most ? s->break_levels[k] : most;
    for (int level = 0; level <= most && enough; level++) {
        const int known = i->broken;
        double from = begin - time_resolution(begin);
        for (int k = 0; k <= known && enough; k++) {
            const double to = k < known ? i->breaks[2 * k] : end + 2 * time_resolution(end);
            if (to > from)
                enough = find_sign_changes(i, level, from, to);
            from = k < known ? i->breaks[2 * k + 1] : to;
        }
        merge_breaks(i);
    }
    arena_release(i, arena);
    if (!enough)
        return instance_say(i, FAILED,
            "%s, t = %.6g s: forces or laws of time have more than %d jumps or kinks up to %.6g s; take shorter "
            "communication steps",
            s->name, begin, MOST_BREAKS, end);
    return DONE;
}
