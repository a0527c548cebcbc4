/* S4: the direction in which the positions of a limit lie where it is not that of the motion. These positions are some
   hundredths of a radian away, whatever the speed. Where time is a coordinate, or something else moves much faster than
   what is singular, the motion would carry all else too far on the way to them. */

#include "way.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

#include "equations.h"
#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "linear.h"
#include "record.h"
#include "scene.h"
#include "scene_sizes.h"
#include "settings.h"
#include "velocities.h"

/* The direction (n) among the settings, zero where it is that of the motion. */
double *way_of(Instance *i)
{
    return instance_field(i, i->scene->k) + scene_way(i->scene);
}

/* Set way to x, so that its fastest coordinate has the rate 1; to zero where nothing moves. */
static void set_unit_way(Instance *i, const double *x, double *way)
{
    const double size = instance_largest(i, x);
    for (int c = 0; c < i->scene->n; c++)
        way[c] = size > 0.0 ? x[c] / size : 0.0;
}

/* Margins at a distance along a direction, on both sides of q. */
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

/* Return by how much a direction leads away from a singular position q of this margin, over the motion of its fastest
   coordinate; 0 where this is indistinguishable. */
static double slope_away(Instance *i, const double *q, const double *way, double margin)
{
    double margins[2], more;
    margins_beside(i, q, way, LEAVING, margins);
    more = (margins[0] + margins[1]) / 2 - margin;
    return more > instance_field(i, i->scene->k)[SETTINGS_NOTHING] ? sqrt(more) / LEAVING : 0.0;
}

/* Return the same beside a singular position, with a sign. */
static double slope_beside(Instance *i, const double *q, const double *way, double margin)
{
    double margins[2];
    margins_beside(i, q, way, LITTLE, margins);
    return (margins[1] - margins[0]) / (4.0 * LITTLE * sqrt(margin));
}

/* Close the constraints at q displaced along a direction; return whether they are. */
static int displace_closed(Instance *i, const double *q, const double *way, double distance, double *closed)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n;
    double *there = arena_alloc(i, n), *zeros = arena_alloc(i, n), *rate = arena_alloc(i, n);
    const double *p = instance_field(i, s->p), *k = instance_field(i, s->k);
    const double *x[] = {there, p, k}, *from[] = {closed, p, k}, *beside[] = {closed, there, zeros, p, k};
    double *to[] = {closed}, *both[] = {closed, rate};
    int row, done;
    memset(zeros, 0, n * sizeof *zeros);
    for (size_t c = 0; c < n; c++)
        there[c] = q[c] + distance * way[c];
    function_call(i, s->place, x, to);
    function_call(i, s->place, from, to);
    function_call(i, s->bring, beside, both);
    function_call(i, s->place, from, to);
    done = constraints_widest(i, closed, zeros, 0, &row) <= GROSS;
    arena_release(i, arena);
    return done;
}

/* Make a direction from a singular position q that of one of the motions that cross there. */
static void follow_branch(Instance *i, const double *q, double *way)
{
    const size_t arena = arena_mark(i), n = (size_t)i->scene->n;
    double *ahead = arena_alloc(i, n), *behind = arena_alloc(i, n);
    set_unit_way(i, way, way);
    if (displace_closed(i, q, way, BESIDE, ahead) && displace_closed(i, q, way, -BESIDE, behind)) {
        for (size_t c = 0; c < n; c++)
            ahead[c] -= behind[c];
        set_unit_way(i, ahead, way);
    }
    arena_release(i, arena);
}

/* Start at a singular position: what is singular may rest, and where time is a coordinate it stands still. The
   direction is then that of the start rates, or of equal rates of the start values. */
void way_begin(Instance *i, const unsigned char *held, const double *q, const double *v)
{
    const Scene *s = i->scene;
    double *way = way_of(i), margin, least = 0.0;
    int paused;
    if (!s->l)
        return;
    memset(way, 0, (size_t)s->n * sizeof *way);
    paused = tape_pause(i, 1);
    margin = settings_continue(i) ? settings_margin(i, q) : 1.0;
    if (margin < BRANCH_MARGIN && !s->timed)
        least = slope_away(i, q, v, margin);
    if (margin < BRANCH_MARGIN && least < SERVES)
        for (int equal = 0; equal < 2; equal++) {
            start_find_way(i, held, q, equal, way);
            if (slope_away(i, q, way, margin) > least) {
                follow_branch(i, q, way);
                break;
            }
            memset(way, 0, (size_t)s->n * sizeof *way);
        }
    tape_pause(i, paused);
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

/* The steepest ascent of the distance on these motions. */
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

/* Before a step on the branch: the direction is that of the motion where this serves, or the one of before, as long
   as it serves or the position is too near to tell. */
void way_update(Instance *i)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n;
    const double *z = instance_field(i, s->z), *v = z + s->n;
    double *way = way_of(i), *possible, margin;
    const int single = s->n - *i->rank <= 1.0, told = linear_largest(way, s->n) > 0.0;
    int paused, near;
    if ((single && !told) || s->n > DENSE)
        return;
    paused = tape_pause(i, 1);
    margin = settings_margin(i, z);
    near = margin < TOO_NEAR * BRANCH_MARGIN;
    if (!s->timed
        && (near ? told && slope_away(i, z, v, margin) > SERVES
                 : single || fabs(slope_beside(i, z, v, margin)) > SERVES))
        memset(way, 0, n * sizeof *way);
    else if (!near) {
        possible = arena_alloc(i, n);
        keep_possible(i, z, way, possible);
        if (fabs(slope_beside(i, z, possible, margin)) > SERVES)
            set_unit_way(i, possible, way);
        else
            climb(i, z, margin, way);
        if (!(fabs(slope_beside(i, z, way, margin)) > FROZEN))
            memset(way, 0, n * sizeof *way);
    }
    tape_pause(i, paused);
    arena_release(i, arena);
}
