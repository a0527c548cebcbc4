/* Largest magnitudes of outputs within a communication step.

   After each internal step the outputs are sampled on a polynomial through the states at both ends and, if no break
   lies between, at the beginning of the previous step, with their rates. The vertex of a parabola through the
   largest sample and its neighbours is one more sample. Samples near a singular position are ignored, because an
   output may have a pole there. */

#include "peaks.h"

#include "inputs.h"
#include "instance.h"
#include "outputs.h"
#include "record.h"
#include "scene.h"
#include "scene_sizes.h"

/* Number of equidistant samples in a step besides its start. */
#define BETWEEN_STEPS 4

/* Number of states, each with its rates, that the polynomial interpolates. */
#define STATES 3

/* Largest ratio of a step to the previous one for which the polynomial uses the state before that one: with states so
   close together it enlarges their round-off by the square of the ratio. */
#define LENGTHENED 10.0

/* Distance of a position [rad, lengths] from the one that follows from the mean of both rates, up to which it may be
   round-off. In a short step such a distance would give the polynomial any rate. */
#define INDISTINCT 1e-10

size_t peaks_room(const Scene *s)
{
    return s->peaks ? 2 * scene_state_length(s) + (size_t)s->seen_size + (size_t)(3 * s->inputs + 4 * s->n)
            + (BETWEEN_STEPS + 2) * (size_t)s->peaks
        : 0;
}

static double *peak_samples(Instance *i)
{
    return i->peaks + i->scene->peaks;
}

/* Restart the polynomial at a break. */
void peaks_broken(Instance *i)
{
    if (i->scene->peaks)
        peak_samples(i)[KNOWN_BEFORE] = 0.0;
}

void peaks_begin(Instance *i)
{
    const Scene *s = i->scene;
    memset(i->peaks, 0, (size_t)s->peaks * sizeof *i->peaks);
    if (s->inputs)
        peaks_broken(i);
}

/* Update the largest magnitudes by those of a sample. */
static void update_magnitudes(Instance *i, double *magnitudes)
{
    const Scene *s = i->scene;
    for (int k = 0; k < s->peaks; k++) {
        double sum = 0.0;
        for (int part = 0; part < 3; part++)
            if (s->peak_parts[3 * k + part] >= 0)
                sum = hypot(sum, i->m[s->seen + s->peak_parts[3 * k + part]]);
        magnitudes[k] = sum;
        i->peaks[k] = fmax(i->peaks[k], sum);
    }
}

/* Interpolate a state and its rate at t: Newton's form with each time twice (Hermite). Take the rate as linear if
   positions differ by at most `indistinct` from those that follow from it. */
static void interpolate_states(int states, const double *times, const double *const *q, const double *const *v, int c,
    double indistinct, double t, double *value, double *rate)
{
    double z[2 * STATES], f[2 * STATES];
    const int count = 2 * states;
    const double h = times[1] - times[0], bend = (v[1][c] - v[0][c]) / h;
    if (fabs(q[1][c] - q[0][c] - h * (v[0][c] + h * bend / 2)) <= indistinct) {
        *rate = v[0][c] + (t - times[0]) * bend;
        *value = q[0][c] + (t - times[0]) * (v[0][c] + *rate) / 2;
        return;
    }
    for (int k = 0; k < count; k++) {
        z[k] = times[k / 2];
        f[k] = q[k / 2][c];
    }
    for (int order = 1; order < count; order++)
        for (int k = count - 1; k >= order; k--)
            f[k] = z[k] != z[k - order] ? (f[k] - f[k - 1]) / (z[k] - z[k - order]) : v[k / 2][c];
    *value = f[count - 1];
    *rate = 0.0;
    for (int k = count - 2; k >= 0; k--) {
        *rate = *value + (t - z[k]) * *rate;
        *value = f[k] + (t - z[k]) * *value;
    }
}

/* Sample the outputs in the step that began at the state `begin` (as z). */
void peaks_along(Instance *i, const double *begin)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n, size = scene_state_length(s);
    double *z = instance_field(i, s->z), *before = peak_samples(i), *end = arena_alloc(i, size),
           *seen = arena_alloc(i, (size_t)s->seen_size);
    double *u = arena_alloc(i, (size_t)s->inputs), *inside = arena_alloc(i, (size_t)s->inputs),
           *rates = arena_alloc(i, (size_t)s->inputs);
    double *found = arena_alloc(i, (BETWEEN_STEPS + 1) * (size_t)s->peaks);
    double *top = arena_alloc(i, (size_t)s->peaks);
    const double from = begin[s->time], h = z[s->time] - from;
    const int known = before[KNOWN_BEFORE] != 0.0 && LENGTHENED * (from - before[TIME_BEFORE]) > h,
              states = known ? 3 : 2;
    const double times[STATES] = {from, from + h, before[TIME_BEFORE]};
    const double *q[STATES] = {begin, end, before + STATE_BEFORE},
                 *v[STATES] = {begin + n, end + n, before + STATE_BEFORE + n};
    int good = 1, paused;
    if (!(h > 0.0)) {
        arena_release(i, arena);
        return;
    }
    paused = tape_pause(i, 1);
    memcpy(end, z, size * sizeof *z);
    memcpy(seen, instance_field(i, s->seen), (size_t)s->seen_size * sizeof *seen);
    memcpy(u, instance_field(i, s->u), (size_t)s->inputs * sizeof *u);
    for (int each = 0; each <= BETWEEN_STEPS + s->peaks; each++) {
        double x = (double)each / BETWEEN_STEPS, t, *here = each <= BETWEEN_STEPS ? found + each * s->peaks : top;
        if (each > BETWEEN_STEPS) { /* the vertex of one of the parabolas */
            const double *y = found + (each - BETWEEN_STEPS - 1);
            int most = 0;
            double bend;
            if (!good)
                break;
            for (int k = 1; k <= BETWEEN_STEPS; k++)
                if (y[k * s->peaks] > y[most * s->peaks])
                    most = k;
            if (most == 0 || most == BETWEEN_STEPS)
                continue;
            bend = y[(most - 1) * s->peaks] - 2 * y[most * s->peaks] + y[(most + 1) * s->peaks];
            if (!(bend < 0.0))
                continue;
            x = (most + (y[(most - 1) * s->peaks] - y[(most + 1) * s->peaks]) / (2 * bend)) / BETWEEN_STEPS;
        }
        t = from + x * h;
        for (int c = 0; c < scene_coordinates(s); c++)
            interpolate_states(states, times, q, v, c,
                INDISTINCT * fmax(fabs(end[c]), strcmp(s->coordinates[c].unit, "m") ? 1.0 : *i->length), t, z + c,
                z + n + c);
        for (size_t k = 0; k < (size_t)scene_states(s); k++)
            z[s->work + 1 + (int)k]
                = begin[s->work + 1 + (int)k] + x * (end[s->work + 1 + (int)k] - begin[s->work + 1 + (int)k]);
        memcpy(instance_field(i, s->u), u, (size_t)s->inputs * sizeof *u);
        inputs_within(i, i->slopes[0], t, inside, rates);
        memcpy(instance_field(i, s->u), inside, (size_t)s->inputs * sizeof *u);
        instance_set_time(i, t);
        if (outputs_read_away(i))
            update_magnitudes(i, here);
        else
            good = 0;
    }
    memcpy(z, end, size * sizeof *z);
    memcpy(instance_field(i, s->seen), seen, (size_t)s->seen_size * sizeof *seen);
    memcpy(instance_field(i, s->u), u, (size_t)s->inputs * sizeof *u);
    before[KNOWN_BEFORE] = 1.0;
    before[TIME_BEFORE] = from;
    memcpy(before + STATE_BEFORE, begin, 2 * n * sizeof *before);
    i->onward = 0;
    tape_pause(i, paused);
    arena_release(i, arena);
}
