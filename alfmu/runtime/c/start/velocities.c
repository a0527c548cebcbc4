#include "velocities.h"

#include "equations.h"
#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "least_squares.h"
#include "linear.h"
#include "loops.h"
#include "message.h"
#include "record.h"
#include "scene.h"
#include "scene_sizes.h"

/* Find velocities that keep the loops closed and have the start rates, nearest to v; `left` is the residue. */
static void solve_rates(Instance *i, Loops *loops, const double *q, const double *rate, double *v, double *left)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *made = arena_alloc(i, (size_t)loops->count), *dv = arena_alloc(i, (size_t)s->n),
           *lam = arena_alloc(i, (size_t)loops->count), *scaled = arena_alloc(i, (size_t)s->n);
    const double *weights = loops->rows;
    const Rows J = {matrix_new(i, &s->constraint), loops->J.ties};
    loops_evaluate(i, loops, q);
    constraints_evaluate(i, q, v, NULL, J.constraints.values, NULL, NULL);
    matrix_weigh(J.constraints, weights, loops->columns);
    matrix_weigh(J.ties, weights + s->l, loops->columns);
    for (int pass = 0; pass < 3; pass++) {
        for (int c = 0; c < s->n; c++)
            scaled[c] = v[c] / loops->columns[c];
        rows_times(&J, scaled, made);
        if (s->timed) { /* Include the motion that constraints prescribe. */
            constraints_evaluate(i, q, v, NULL, NULL, NULL, made);
            for (int r = 0; r < s->l; r++)
                made[r] *= weights[r];
        }
        for (int r = 0; r < loops->count; r++)
            left[r] = (r < s->l ? 0.0 : weights[r] * rate[s->tied[r - s->l]]) - made[r];
        if (pass == 2)
            break;
        rows_least_multipliers(i, &J, left, CORRECTIONS, lam, dv);
        tape_correction(i, weights, loops->columns, q, v, dv, lam, 1.0);
        for (int c = 0; c < s->n; c++)
            v[c] += loops->columns[c] * dv[c];
    }
    for (int r = 0; r < loops->count; r++)
        left[r] = weights[r] > 0.0 ? left[r] / weights[r] : 0.0;
    arena_release(i, arena);
}

/* Find velocities that keep the loops closed and have the start rates, nearest to the guess v. */
Outcome start_rates(Instance *i, Loops *loops, const double *q, double *v)
{
    const Scene *s = i->scene;
    const size_t n = (size_t)s->n, l = (size_t)s->l, count = (size_t)loops->count;
    const double *rate = loops_starts(i) + s->starts;
    double *left = arena_alloc(i, count), *made = arena_alloc(i, count), *dv = arena_alloc(i, n),
           *F = arena_alloc(i, n);
    double *zeros = arena_alloc(i, (size_t)scene_driven(s) + 1),
           *M = arena_alloc(i, (size_t)s->mass.entries);
    double lost = 0.0, most;
    const double zero = 0.0;
    Rows J = {matrix_new(i, &s->constraint), loops->J.ties};
    int worst = 0;
    solve_rates(i, loops, q, rate, v, left);
    for (int r = 1; r < loops->count; r++)
        if (loops->rows[r] * fabs(left[r]) > loops->rows[worst] * fabs(left[worst]))
            worst = r;
    if (!(linear_largest(left, loops->count) <= ROUGH * fmax(1.0, instance_largest(i, v))))
        return instance_say(i, FAILED,
            "%s: no motion has the given start rates; %s is violated by %.3g per second; give the rates of fewer "
            "coordinates, or rates that belong together",
            s->name,
            worst < s->l ? s->rows[worst].name
                         : s->variables[s->own + s->starts + s->tied[worst - s->l]].name,
            fabs(left[worst]));
    if (!s->l)
        return DONE;
    {
        const double *x[] = {q, v, zeros, instance_field(i, s->p), &zero};
        double *y[] = {M, J.constraints.values, F, left};
        memset(zeros, 0, ((size_t)scene_driven(s) + 1) * sizeof *zeros);
        function_call(i, s->dynamics, x, y);
    }
    matrix_weigh(J.constraints, loops->rows, loops->columns);
    memset(J.ties.values, 0, (size_t)s->tie_rows.entries * sizeof *J.ties.values);
    memset(left + l, 0, (size_t)s->ties * sizeof *left);
    for (int r = 0; r < s->l; r++)
        left[r] *= loops->rows[r];
    /* Two passes leave residues in directions that C hardly holds, which a motion violates in proportion to its
       acceleration. */
    rows_least_correction(i, &J, left, 2, dv);
    matrix_times(J.constraints, dv, made);
    most = linear_largest(left, s->l);
    for (int r = 0; r < s->l; r++)
        if (fabs(left[r] - made[r]) > lost) {
            lost = fabs(left[r] - made[r]);
            worst = r;
        }
    if (lost > 1e-3 * fmax(1.0, most))
        return instance_say(i, FAILED,
            "%s: the start is a singular position, and its rates belong to none of the motions possible there (%s "
            "would open by %.3g %s/s2); start a little beside it",
            s->name, s->rows[worst].name, lost / loops->rows[worst], s->rows[worst].unit);
    return DONE;
}

/* Find the direction of motion at fixed time for the start rates or, with `equal`, for equal rates of all start values
   except Euler parameters, which cannot all grow; zero if there is none. With `equal` = 2 it is the part of the given
   direction for which all start values rest. */
void start_find_way(Instance *i, const unsigned char *held, const double *q, int equal, double *way)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n;
    const int paused = tape_pause(i, 1);
    double *guess = arena_alloc(i, n), *rates = arena_alloc(i, (size_t)s->starts), size;
    const double *x[] = {instance_field(i, s->p), loops_starts(i), rates};
    double *y[] = {guess, way};
    Loops loops = loops_new(i, held, *i->length);
    for (int k = 0; k < s->starts; k++)
        rates[k] = equal == 2 ? 0.0
            : equal         ? strcmp(s->variables[s->own + k].unit, "1") != 0
                            : loops_starts(i)[s->starts + k];
    if (equal != 2)
        function_call(i, s->guesses, x, y);
    if (s->timed)
        way[s->n - 1] = 0.0;
    solve_rates(i, &loops, q, rates, way, loops.residue);
    size = linear_largest(way, s->n);
    /* Closer than the root of LOOSE to a singular position, the row that vanishes there is left open by as much. */
    if (!(size > 0.0 && linear_largest(loops.residue, loops.count) <= sqrt(LOOSE) * size))
        memset(way, 0, n * sizeof *way);
    tape_pause(i, paused);
    arena_release(i, arena);
}
