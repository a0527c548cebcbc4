#include "calibration.h"

#include "equations.h"
#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "rank.h"
#include "record.h"
#include "row_units.h"
#include "scene.h"
#include "scene_sizes.h"

/* Sort a few numbers in increasing order. */
static void sort_numbers(double *x, int count)
{
    for (int a = 1; a < count; a++)
        for (int b = a; b > 0 && x[b] < x[b - 1]; b--) {
            const double swapped = x[b];
            x[b] = x[b - 1];
            x[b - 1] = swapped;
        }
}

/* Return the median of sorted numbers. */
static double median(const double *x, int count)
{
    return (x[(count - 1) / 2] + x[count / 2]) / 2;
}

/* Round a logarithm, so that the result does not depend on the round-off of a processor. */
static double round_coarsely(double x)
{
    return floor(x * COARSE + 0.5) / COARSE;
}

/* S1: logarithms of products of pivots at a position, the largest mass over its scale, and the number of pivots below
   SMALL_PIVOT. */
typedef struct {
    double smallest, small, all, heaviest;
    int few;
} Pivots;

static Pivots multiply_pivots(Instance *i, const double *q, int smallest)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n;
    Pivots found = {0.0, 0.0, 0.0, 0.0, 0};
    double *pivots = arena_alloc(i, n), *unused = arena_alloc(i, n);
    const double *x[] = {q, instance_field(i, s->p), instance_field(i, s->k)};
    double *y[] = {pivots, unused, unused, &found.heaviest};
    int bad = 0;
    function_call(i, s->pivots, x, y);
    for (int c = 0; c < s->n; c++)
        bad |= !(pivots[c] > 0.0);
    sort_numbers(pivots, bad ? 0 : s->n);
    for (int c = 0; c < s->n; c++) {
        const double part = log(bad ? 1e-300 : fmax(pivots[c], 1e-300));
        found.smallest += c < smallest ? part : 0.0;
        found.small += c < smallest || pivots[c] < SMALL_PIVOT ? part : 0.0;
        found.all += part;
        found.few += pivots[c] < SMALL_PIVOT;
    }
    arena_release(i, arena);
    return found;
}

/* S1: return the typical product of the smallest pivots, as a logarithm. */
static double typical_smallest(const Pivots *places, int count)
{
    double found[SIDE_PLACES + 1];
    int second;
    for (int a = 0; a < count; a++)
        found[a] = places[a].smallest;
    /* The start, which may be singular, is among the positions twice. */
    sort_numbers(found, count);
    second = count > 1 && found[1] == found[0] ? 2 : 1;
    while (count > second && !(found[count - 1] <= found[second] + FAR_RATIO))
        count--;
    return median(found, count);
}

/* S1: return the typical product of all small pivots at regular positions. At a position with more small pivots, as
   near a singular one, the product of all pivots is smaller; the difference corrects for that. */
static double typical_small(const Pivots *places, int count)
{
    double found[SIDE_PLACES + 1], largest = -INFINITY;
    for (int a = 0; a < count; a++)
        largest = fmax(largest, places[a].all);
    for (int a = 0; a < count; a++)
        found[a] = places[a].small + largest - places[a].all;
    sort_numbers(found, count);
    return median(found, count);
}

/* S1: find the product of pivots at which the margin is 1, and the margin that masses leave at a singular position. A
   coordinate that hardly describes the motion has a larger pivot than masses contribute, and a coordinate that
   constraints hold by a small coefficient has a smaller one. Each Euler parameter is one or the other in the course of
   a turn. */
static void calibrate_margin(Instance *i, const Pivots *places, int count)
{
    const Scene *s = i->scene;
    const double freedom = *i->freedom, raised = (float)(RAISED * places[0].heaviest);
    double typical = typical_smallest(places, count);
    int turns = 0;
    for (int c = 0; c < s->n; c++)
        turns |= !strcmp(s->coordinates[c].unit, "1");
    if (freedom > 0.0 && raised > 0.0 && (turns || typical > freedom * log(raised))) {
        *i->masses = round_coarsely(typical_small(places, count));
        *i->least_margin = raised;
    } else {
        *i->masses = round_coarsely(typical);
        *i->least_margin = freedom > 0.0 ? exp(*i->masses / freedom) : 0.0;
    }
}

/* Close the constraints at the position `there`, by at most so many more corrections; displaced along the motion v,
   `near` becomes the nearest position. Return whether they are closed. */
static int close_near(Instance *i, const double *there, const double *v, int more, double *near)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    const double *p = instance_field(i, s->p), *k = instance_field(i, s->k);
    const double *x[] = {there, p, k}, *from[] = {near, p, k}, *beside[] = {near, there, v, p, k};
    double *to[] = {near}, *both[] = {near, arena_alloc(i, (size_t)s->n)};
    int row, closed;
    function_call(i, s->place, x, to);
    function_call(i, s->place, from, to);
    function_call(i, s->bring, beside, both);
    function_call(i, s->place, from, to);
    while (!(closed = constraints_widest(i, near, v, 0, &row) <= GROSS) && more-- > 0)
        function_call(i, s->place, from, to);
    arena_release(i, arena);
    return closed;
}

int calibration_close(Instance *i, const double *there, const double *v, double *near)
{
    return close_near(i, there, v, 0, near);
}

/* S1: places along a way, how much constraints touch each coordinate there, and the products of pivots. */
typedef struct {
    double *scales, *touched, freedom;
    Pivots found[SIDE_PLACES + 1];
    int count;
} Survey;

/* Take the masses as unknown. */
static void forget_masses(Instance *i)
{
    double *k = instance_field(i, i->scene->k);
    k[SETTINGS_NOTHING] = 0.0;
    for (int c = 0; c < i->scene->n; c++)
        k[SETTINGS + 2 * i->scene->l + c] = 1.0;
}

/* Scale pivots by the scales of a survey. */
static void use_scales(Instance *i, const Survey *survey)
{
    double *inverse_scales = instance_field(i, i->scene->k) + SETTINGS + 2 * i->scene->l;
    for (int c = 0; c < i->scene->n; c++)
        inverse_scales[c] = *i->largest_penalty / survey->scales[c];
}

/* Find a random motion at q at fixed time; with `rest`, of what v leaves at rest. Euler parameters then stay, too, as
   no value of theirs is singular. */
static void find_random_way(Instance *i, const double *q, const double *v, const double *random, int rest, double *way)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n;
    double *there = arena_alloc(i, n), *still = arena_alloc(i, n), *rate = arena_alloc(i, n);
    const double *x[] = {q, there, still, instance_field(i, s->p), instance_field(i, s->k)};
    double *y[] = {way, rate};
    memcpy(still, v, n * sizeof *still);
    memset(still, 0, (size_t)scene_coordinates(s) * sizeof *still);
    for (int c = 0; c < s->n; c++) {
        const double size = coordinate_is_length(s, c) ? *i->length : 1.0;
        const int stays = rest && (v[c] != 0.0 || !strcmp(s->coordinates[c].unit, "1"));
        there[c] = q[c] + (stays ? 0.0 : size * random[c]);
    }
    function_call(i, s->bring, x, y);
    for (int c = 0; c < s->n; c++)
        way[c] -= q[c];
    arena_release(i, arena);
}

/* Let neighbouring Euler parameters share the largest of their numbers. */
static void share_of_turns(const Scene *s, double *x)
{
    const Coordinate *c = s->coordinates;
    for (int k = 1; k < s->n; k++)
        if (!strcmp(c[k - 1].unit, "1") && !strcmp(c[k].unit, "1"))
            x[k] = fmax(x[k], x[k - 1]);
    for (int k = s->n - 1; k > 0; k--)
        if (!strcmp(c[k - 1].unit, "1") && !strcmp(c[k].unit, "1"))
            x[k - 1] = x[k];
}

/* S1: raise the scales of coordinates whose share of the diagonal of H at a position is less than `share`. */
static void raise_scales(Instance *i, const double *q, double share, Survey *survey)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n;
    double *pivots = arena_alloc(i, n), *diagonal = arena_alloc(i, n), *columns = arena_alloc(i, n), heaviest;
    const double *x[] = {q, instance_field(i, s->p), instance_field(i, s->k)};
    double *y[] = {pivots, diagonal, columns, &heaviest};
    function_call(i, s->pivots, x, y);
    for (int c = 0; c < s->n; c++)
        if (survey->scales[c] < share * *i->largest_penalty * diagonal[c]) {
            survey->scales[c] = *i->largest_penalty * diagonal[c];
            survey->touched[c] += columns[c];
        }
    arena_release(i, arena);
}

/* S1: survey the places along the motion v at q or, if v rests, along a random motion; with `rest`, along a motion of
   what v leaves at rest. */
static void survey_along(
    Instance *i, const double *q, const double *v, const double *random, int rest, int freedom, Survey *survey)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n;
    const double *p = instance_field(i, s->p), *k = instance_field(i, s->k);
    double *way = arena_alloc(i, n), *there = arena_alloc(i, n), *near = arena_alloc(i, n), *rate = arena_alloc(i, n);
    double *pivots = arena_alloc(i, n), *diagonal = arena_alloc(i, n), *columns = arena_alloc(i, n);
    double *places = arena_alloc(i, (SIDE_PLACES + 1) * n), size, heaviest;
    const int still = linear_largest(v, scene_coordinates(s)) == 0.0;
    forget_masses(i);
    survey->count = 1;
    memcpy(rate, v, n * sizeof *rate);
    memcpy(way, v, n * sizeof *way);
    memset(survey->touched, 0, n * sizeof *survey->touched);
    memset(survey->scales, 0, n * sizeof *survey->scales);
    if (rest)
        memset(rate, 0, (size_t)scene_coordinates(s) * sizeof *rate);
    if (rest || still)
        find_random_way(i, q, v, random, rest, way);
    size = fmax(instance_largest(i, way), 1e-300);
    for (int c = 0; c < s->n; c++)
        way[c] /= size;
    memcpy(places, q, n * sizeof *q);
    for (int a = 0; a < SIDE_PLACES; a++) {
        const double *x[] = {there, p, k};
        double *y[] = {pivots, diagonal, columns, &heaviest};
        for (int c = 0; c < s->n; c++)
            there[c] = q[c] + side_places[a] * way[c];
        function_call(i, s->pivots, x, y);
        for (int c = 0; c < s->n; c++) {
            survey->touched[c] += columns[c];
            survey->scales[c] = fmax(survey->scales[c], *i->largest_penalty * diagonal[c]);
        }
        if (close_near(i, there, rate, rest ? MOST_RETURNS : 0, near))
            memcpy(places + survey->count++ * n, near, n * sizeof *near);
    }
    /* One of the motions that cross at a singular position may leave coordinates free that constraints touch where
       others differ. */
    for (int c = 0; c < s->n; c++) {
        const double size = coordinate_is_angle(s, c) ? 1.0 : coordinate_is_length(s, c) ? *i->loop : 0.0;
        there[c] = q[c] + size * side_places[SIDE_PLACES - 1] * random[c];
    }
    raise_scales(i, there, HARDLY, survey);
    if (rest) {
        share_of_turns(s, survey->scales);
        share_of_turns(s, survey->touched);
    }
    survey->freedom = freedom;
    for (int c = 0; c < s->n; c++)
        survey->freedom -= survey->touched[c] == 0.0;
    use_scales(i, survey);
    /* Beside a singular position the places of a random motion may be between two motions before they are closed. */
    if ((rest || still) && multiply_pivots(i, q, (int)survey->freedom).few > survey->freedom) {
        for (int a = 0; a < survey->count; a++)
            raise_scales(i, places + a * n, 1.0, survey);
        use_scales(i, survey);
    }
    for (int a = 0; a < survey->count; a++)
        survey->found[a] = multiply_pivots(i, places + a * n, (int)survey->freedom);
    arena_release(i, arena);
}

/* Return the largest product of pivots of a survey, as a logarithm, times their scales. */
static double most_regular(const Instance *i, const Survey *survey)
{
    double most = -INFINITY, scales = 0.0;
    for (int a = 0; a < survey->count; a++)
        most = fmax(most, survey->found[a].all);
    for (int c = 0; c < i->scene->n; c++)
        scales += log(survey->scales[c]);
    return most + scales;
}

/* Return whether all places of a survey may be singular. */
static int may_stay_singular(const Survey *survey)
{
    int few = survey->found[0].few;
    for (int a = 1; a < survey->count; a++)
        few = survey->found[a].few < few ? survey->found[a].few : few;
    return few > survey->freedom;
}

/* S1: find the scales of coordinates, the pivots contributed by masses, the degrees of freedom and the rank. */
void calibration_find(Instance *i, const double *q, const double *v, const unsigned char *held, int usual)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n;
    double *there = arena_alloc(i, n), together[SIDE_PLACES + 1];
    Survey surveys[3], *taken = surveys, *other = surveys + 1;
    int freedom = s->freedom + s->timed, here;
    for (int a = 0; a < 3; a++) {
        surveys[a].scales = arena_alloc(i, n);
        surveys[a].touched = arena_alloc(i, n);
    }
    if (!usual || s->freedom < 0)
        freedom = rank_freedom_near(i, q, held, &here, there);
    *i->rank = s->n - freedom;
    survey_along(i, q, v, s->normal, 0, freedom, taken);
    /* If a loop rests in or beside a singular position, maybe while another part moves, places along that motion may
       all be singular, and those along a random one may not close. */
    for (int k = 0; k < RANKED && s->n <= DENSE && may_stay_singular(surveys); k++) {
        survey_along(i, q, v, s->normal + k * s->n, 1, freedom, other);
        if (most_regular(i, other) > most_regular(i, taken) - (taken == surveys ? log(REGULAR_PRODUCT) : 0.0)) {
            taken = other;
            other = surveys + (taken == surveys + 1 ? 2 : 1);
        }
    }
    use_scales(i, taken);
    *i->freedom = taken->freedom;
    memcpy(i->scales, taken->scales, n * sizeof *i->scales);
    i->flags.brakes = rank_changes_near(i, q, v);
    for (int a = 0; a < taken->count; a++)
        together[a] = taken->found[a].all;
    /* A coordinate that cannot describe the motion makes the product far larger, a singular position smaller. */
    sort_numbers(together, taken->count);
    *i->regular = median(together, taken->count) + log(REGULAR_PRODUCT);
    calibrate_margin(i, taken->found, taken->count);
    for (int c = 0; c < s->n; c++)
        i->scales[c] = (float)i->scales[c];
    arena_release(i, arena);
}
