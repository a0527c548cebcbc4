/* S4: the direction along which a limit at a singular position is taken, if it is not the motion's. The positions of a
   limit are some hundredths of a radian away, at any speed. If time is a coordinate, or if another part moves much
   faster than the singular one, the motion would displace everything else too far at these positions. */

#include "way.h"

#include "calibration.h"
#include "equations.h"
#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "linear.h"
#include "message.h"
#include "record.h"
#include "scene.h"
#include "scene_sizes.h"
#include "settings.h"
#include "velocities.h"

/* Return the direction (n) among the settings; zero if it is the motion's. */
static double *way_of(Instance *i)
{
    return instance_field(i, i->scene->k) + scene_way(i->scene);
}

/* Set way to x, scaled so that its fastest coordinate except time has the rate 1; to zero if nothing moves. */
static void set_unit_way(Instance *i, const double *x, double *way)
{
    const Scene *s = i->scene;
    double size = 0.0;
    for (int c = 0; c < scene_coordinates(s); c++)
        size = fmax(size, fabs(x[c]) / (coordinate_is_length(s, c) ? *i->length : 1.0));
    for (int c = 0; c < s->n; c++)
        way[c] = size > 0.0 ? x[c] / size : 0.0;
}

/* Take limits along the motion from now on. */
static void set_along(Instance *i)
{
    memset(way_of(i), 0, (size_t)i->scene->n * sizeof(double));
    instance_field(i, i->scene->k)[SETTINGS_ALONG] = 1.0;
}

/* Return whether the mechanism has a single motion, hence a single direction; assume it for many coordinates. */
static int has_single_motion(const Instance *i)
{
    return i->scene->n - *i->rank <= 1.0 || i->scene->n > DENSE;
}

/* Compute the margins at a distance along a direction, on both sides of q. */
static void margins_beside(Instance *i, const double *q, const double *way, double distance, double margins[2])
{
    const size_t arena = arena_mark(i), n = (size_t)i->scene->n;
    double *unit = arena_alloc(i, n), *there = arena_alloc(i, n);
    set_unit_way(i, way, unit);
    for (int side = 0; side < 2; side++) {
        for (size_t c = 0; c < n; c++)
            there[c] = q[c] + (side ? distance : -distance) * unit[c];
        margins[side] = settings_margin(i, there);
    }
    arena_release(i, arena);
}

/* Return how fast the distance from the singular position at q, whose margin is given, grows along a direction,
   relative to the motion of its fastest coordinate; 0 if the growth is indistinguishable from round-off. */
static double slope_away(Instance *i, const double *q, const double *way, double margin)
{
    double margins[2], more;
    margins_beside(i, q, way, LEAVING, margins);
    more = (margins[0] + margins[1]) / 2 - margin;
    return more > instance_field(i, i->scene->k)[SETTINGS_NOTHING] ? sqrt(more) / LEAVING : 0.0;
}

/* Return how fast the distance changes along a direction, with its sign, at a position q near a singular one. */
static double slope_beside(Instance *i, const double *q, const double *way, double margin)
{
    double margins[2];
    margins_beside(i, q, way, LITTLE, margins);
    return (margins[1] - margins[0]) / (4.0 * LITTLE * sqrt(margin));
}

/* Replace a direction from a singular position q by that of one of the motions that cross there, and compute what
   `changed`. Return whether the direction was already that motion. */
static int follow_branch(Instance *i, const double *q, double *way, double *changed)
{
    const size_t arena = arena_mark(i), n = (size_t)i->scene->n;
    double *there = arena_alloc(i, n), *zeros = arena_alloc(i, n), *sides[2] = {arena_alloc(i, n), arena_alloc(i, n)};
    int closed = 1;
    memset(zeros, 0, n * sizeof *zeros);
    set_unit_way(i, way, way);
    for (int side = 0; side < 2; side++) {
        for (size_t c = 0; c < n; c++)
            there[c] = q[c] + (side ? BESIDE : -BESIDE) * way[c];
        closed &= calibration_close(i, there, zeros, sides[side]);
    }
    for (size_t c = 0; c < n; c++)
        there[c] = sides[1][c] - sides[0][c];
    set_unit_way(i, there, there);
    for (size_t c = 0; c < n; c++)
        changed[c] = there[c] - way[c];
    if (closed)
        memcpy(way, there, n * sizeof *way);
    arena_release(i, arena);
    return closed && instance_largest(i, changed) < BESIDE;
}

/* Replace a direction from a singular position q, as the start values have it, by that of a motion. Return whether they
   select that motion: a mixture of two does so only if they all rest in the other one. */
static int select_branch(Instance *i, const unsigned char *held, const double *q, double *way)
{
    const size_t arena = arena_mark(i), n = (size_t)i->scene->n;
    double *other = arena_alloc(i, n), *changed = arena_alloc(i, n);
    int selected = follow_branch(i, q, way, other);
    if (!selected) {
        start_find_way(i, held, q, 2, other);
        selected = linear_largest(other, i->scene->n) > 0.0 && follow_branch(i, q, other, changed);
    }
    arena_release(i, arena);
    return selected;
}

/* Compute the part of a small displacement of q that is possible while time stands still. */
static void keep_possible(Instance *i, const double *q, const double *moved, double *possible)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n;
    double *zeros = arena_alloc(i, n), *there = arena_alloc(i, n), *rate = arena_alloc(i, n);
    const double *x[] = {q, there, zeros, instance_field(i, s->p), instance_field(i, s->k)};
    double *y[] = {possible, rate};
    memset(zeros, 0, n * sizeof *zeros);
    for (size_t c = 0; c < n; c++)
        there[c] = q[c] + LITTLE * moved[c];
    function_call(i, s->bring, x, y);
    for (size_t c = 0; c < n; c++)
        possible[c] = (possible[c] - q[c]) / LITTLE;
    arena_release(i, arena);
}

/* Find the direction in which the distance from the singular position increases most. */
static void climb(Instance *i, const double *q, double margin, double *way)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n;
    double *one = arena_alloc(i, n), *moved = arena_alloc(i, n), *sum = arena_alloc(i, n);
    memset(sum, 0, n * sizeof *sum);
    for (int c = 0; c < scene_coordinates(s); c++) {
        double size;
        memset(one, 0, n * sizeof *one);
        one[c] = coordinate_is_length(s, c) ? *i->length : 1.0;
        keep_possible(i, q, one, moved);
        size = instance_largest(i, moved);
        if (size > FROZEN) {
            const double slope = slope_beside(i, q, moved, margin) * size;
            for (size_t d = 0; d < n; d++)
                sum[d] += slope * moved[d];
        }
    }
    set_unit_way(i, sum, way);
    arena_release(i, arena);
}

/* Choose the direction of limits at q: the possible part of the previous direction, or else the steepest ascent of the
   distance; along the motion if the distance changes along neither. */
static void point_way(Instance *i, const double *q)
{
    const size_t arena = arena_mark(i);
    const double margin = settings_margin(i, q);
    double *way = way_of(i), *possible = arena_alloc(i, (size_t)i->scene->n);
    keep_possible(i, q, way, possible);
    if (fabs(slope_beside(i, q, possible, margin)) > SERVES)
        set_unit_way(i, possible, way);
    else
        climb(i, q, margin, way);
    if (fabs(slope_beside(i, q, way, margin)) > FROZEN)
        instance_field(i, i->scene->k)[SETTINGS_ALONG] = 0.0;
    else
        set_along(i);
    arena_release(i, arena);
}

/* Choose the direction at the start, which may be a singular position. If the singular part rests, the direction is
   that of the start rates, or of equal rates of the start values. If time is a coordinate, it is a direction at fixed
   time, chosen at a position beside the start on the branch of the motion. */
void way_begin(Instance *i, const unsigned char *held, const double *q, const double *v)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n;
    double *way, *along = instance_field(i, s->k) + SETTINGS_ALONG, *near, *there, margin, least;
    int paused;
    if (!s->l)
        return;
    way = way_of(i);
    near = arena_alloc(i, n);
    there = arena_alloc(i, n);
    set_along(i);
    paused = tape_pause(i, 1);
    margin = settings_continue(i) ? settings_margin(i, q) : 1.0;
    least = margin < BRANCH_MARGIN ? slope_away(i, q, v, margin) : SERVES;
    for (int equal = 0; least < SERVES && equal < 2 && *along > 0.0; equal++) {
        start_find_way(i, held, q, equal, way);
        *along = !(slope_away(i, q, way, margin) > least);
    }
    if (*along > 0.0 ? least == 0.0 : !select_branch(i, held, q, way))
        instance_warn(i, WARNED_OF_REST,
            "%s: it, or a part of it, starts at rest in a singular position, and no start value selects one of the "
            "motions that cross there; give a start value or rate, or start beside it",
            s->name);
    if (*along > 0.0) {
        set_along(i);
        if (margin < BRANCH_MARGIN && s->timed && least >= SERVES && !has_single_motion(i)) {
            set_unit_way(i, v, there);
            for (size_t c = 0; c < n; c++)
                there[c] = q[c] + BESIDE * there[c];
            if (calibration_close(i, there, v, near))
                point_way(i, near);
        }
    }
    tape_pause(i, paused);
    arena_release(i, arena);
}

/* Choose the direction before a step on the branch: the motion if the distance changes enough along it; otherwise the
   previous direction while it serves, or while the position is too near to judge. */
void way_update(Instance *i)
{
    const Scene *s = i->scene;
    const double *z = instance_field(i, s->z), *v = z + s->n, *along = instance_field(i, s->k) + SETTINGS_ALONG;
    double margin;
    const int single = has_single_motion(i);
    int paused, near;
    if (single && *along > 0.0)
        return;
    paused = tape_pause(i, 1);
    margin = settings_margin(i, z);
    near = margin < TOO_NEAR * BRANCH_MARGIN;
    if (!s->timed
        && (near ? *along > 0.0 || slope_away(i, z, v, margin) > SERVES
                 : single || fabs(slope_beside(i, z, v, margin)) > SERVES))
        set_along(i);
    else if (!near)
        point_way(i, z);
    tape_pause(i, paused);
}
