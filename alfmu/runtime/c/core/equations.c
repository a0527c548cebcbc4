#include "equations.h"

#include "instance.h"
#include "interpret.h"
#include "layout.h"
#include "record.h"
#include "scene.h"

/* Expand the nonzeros of a matrix into a dense one, whose columns are `rows` long. */
void pattern_spread(const Pattern *pattern, const double *values, double *dense, int rows)
{
    for (int c = 0; c < pattern->columns; c++) {
        memset(dense + c * rows, 0, (size_t)pattern->rows * sizeof *dense);
        for (int k = pattern->offsets[c]; k < pattern->offsets[c + 1]; k++)
            dense[c * rows + pattern->indices[k]] = values[k];
    }
}

/* Evaluate M and C (their nonzeros), Phi and C v; each result may be NULL. */
void constraints_evaluate(
    Instance *i, const double *q, const double *v, double *mass, double *matrix, double *phi, double *cv)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), l = (size_t)s->l;
    const double *x[] = {q, v, instance_field(i, s->p)};
    double *y[] = {mass ? mass : arena_alloc(i, (size_t)s->mass.entries),
        matrix ? matrix : arena_alloc(i, (size_t)s->constraint.entries), phi ? phi : arena_alloc(i, l),
        cv ? cv : arena_alloc(i, l)};
    function_call(i, s->constraints, x, y);
    arena_release(i, arena);
}

/* Return the largest |Phi|, or |Phi-dot|, in units of its row, and the index of that row. */
double constraints_widest(Instance *i, const double *q, const double *v, int of_velocity, int *row)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *phi = arena_alloc(i, (size_t)s->l), *cv = arena_alloc(i, (size_t)s->l), found = 0.0;
    constraints_evaluate(i, q, v, NULL, NULL, phi, cv);
    *row = 0;
    for (int r = 0; r < s->l; r++) {
        const double size = fabs((of_velocity ? cv : phi)[r] / i->units[r]);
        if (i->penalty[r] > 0.0 && !(size <= found)) {
            found = isnan(size) ? INFINITY : size;
            *row = r;
        }
    }
    arena_release(i, arena);
    return found;
}

/* Return the kinetic and potential energy at velocities v, and the kinetic energy alone. */
double energy_evaluate(Instance *i, const double *v, double *kinetic)
{
    const Scene *s = i->scene;
    double found;
    const double *x[] = {instance_field(i, s->z), v, instance_field(i, s->p)};
    double *y[] = {&found, kinetic};
    function_call(i, s->energy, x, y);
    return found;
}

/* Compute the energies now into two places, recorded if there is a tape. */
void energy_record(Instance *i, const double *v, double *into)
{
    const Scene *s = i->scene;
    const double *x[] = {instance_field(i, s->z), v, instance_field(i, s->p)};
    double *y[] = {into, into + 1};
    function_call_recorded(i, s->energy, x, y);
}

/* Add the change of energy in an instant to the work; `energies` has those before it, then room for those after. */
void energy_add_jump(Instance *i, double *energies)
{
    double *q = instance_field(i, i->scene->z), *work = q + i->scene->work;
    const double *from[] = {work, energies + 2, energies}, factors[] = {1.0, 1.0, -1.0};
    energy_record(i, q + i->scene->n, energies + 2);
    *work += energies[2] - energies[0];
    tape_sum(i, work, 3, from, factors);
}

/* Return the kinetic energy if all velocities have this size. */
double energy_at_speed(Instance *i, double speed)
{
    const size_t arena = arena_mark(i), n = (size_t)i->scene->n;
    double *v = arena_alloc(i, n), kinetic;
    for (size_t k = 0; k < n; k++)
        v[k] = speed;
    energy_evaluate(i, v, &kinetic);
    arena_release(i, arena);
    return kinetic;
}

int coordinate_is_length(const Scene *s, int coordinate)
{
    return !strcmp(s->coordinates[coordinate].unit, "m");
}

int coordinate_is_angle(const Scene *s, int coordinate)
{
    return !strcmp(s->coordinates[coordinate].unit, "rad");
}

/* Return the largest entry of coordinates, of displacements or of rates; lengths are divided by the mechanism's. */
double instance_largest(const Instance *i, const double *x)
{
    const Scene *s = i->scene;
    double found = 0.0;
    for (int c = 0; c < s->n; c++)
        found = fmax(found, fabs(x[c]) / (coordinate_is_length(s, c) ? *i->length : 1.0));
    return found;
}

/* Return how far points of the ground, or coordinates, are from the origin, over the size of the smallest loop. */
double constraints_reach(const Instance *i, const double *q)
{
    const Scene *s = i->scene;
    double far = s->farthest / *i->loop;
    for (int c = 0; c < s->n; c++)
        far = coordinate_is_length(s, c) ? fmax(far, fabs(q[c]) / *i->loop) : far;
    return far;
}

/* Compute the limits (l) of |Phi|, or of |Phi-dot| at velocities v: the tolerance, or the round-off of the row, or of
   places, to which redundant constraints agree. */
void constraints_limits(const Instance *i, const double *C, const double *q, const double *v, double *limits)
{
    const Scene *s = i->scene;
    const Pattern *p = &s->constraint;
    const double *x = v ? v : q;
    const double far = constraints_reach(i, q) * (v ? instance_largest(i, v) : 1.0);
    memset(limits, 0, (size_t)s->l * sizeof *limits);
    for (int c = 0; c < s->n; c++)
        for (int e = p->offsets[c]; e < p->offsets[c + 1]; e++)
            limits[p->indices[e]] += fabs(C[e] * x[c]);
    for (int r = 0; r < s->l; r++)
        limits[r] = fmax(i->values[s->tolerance] * i->units[r], ROUND_OFF * fmax(far * i->units[r], limits[r]));
    for (int r = 0; v && r < s->l; r++)
        limits[r] = fmax(limits[r], *i->agreed * instance_largest(i, v) * i->units[r]);
}
