#include "masses.h"

#include "equations.h"
#include "instance.h"
#include "layout.h"
#include "least_squares.h"
#include "linear.h"
#include "message.h"
#include "scene.h"

/* Find the motion (n) that masses and constraints hold least; return that singular value of [M / scale; C]. */
static double find_weakest_motion(Instance *i, Matrix M, Matrix C, double scale, double *motion)
{
    const Scene *s = i->scene;
    const int n = s->n, rows = n + s->l;
    const size_t arena = arena_mark(i), side = (size_t)n;
    double *both = arena_alloc(i, (size_t)rows * side), *V = arena_alloc(i, side * side), *sizes = arena_alloc(i, side),
           least;
    pattern_spread(M.pattern, M.values, both, rows);
    pattern_spread(C.pattern, C.values, both + n, rows);
    for (int c = 0; c < n; c++)
        for (int r = 0; r < n; r++)
            both[c * rows + r] /= scale;
    linear_singular_values(rows, n, both, V, sizes);
    memcpy(motion, V + (n - 1) * n, side * sizeof *motion);
    least = sizes[n - 1];
    arena_release(i, arena);
    return least;
}

/* Find the weakest motion of many coordinates by inverse iteration: an eigenvector of M / scale + C' C. */
static double find_weakest_of_many(Instance *i, Matrix M, Matrix C, double scale, double *motion)
{
    const Scene *s = i->scene;
    const Envelope *e = &s->holding;
    const size_t arena = arena_mark(i);
    double *a = arena_alloc(i, e->entries), *work = arena_alloc(i, (size_t)s->n), size = 0.0;
    const Pattern *m = M.pattern, *p = C.pattern;
    memset(a, 0, e->entries * sizeof *a);
    for (int c = 0; c < s->n; c++) {
        for (int k = m->offsets[c]; k < m->offsets[c + 1]; k++)
            if (m->indices[k] <= c)
                *envelope_entry(e, a, c, m->indices[k]) += M.values[k] / scale;
    }
    /* Compute C' C within the envelope. */
    for (int c = 0; c < s->n; c++)
        for (int d = 0; d <= c; d++) {
            double sum = 0.0;
            if (e->place[d] < e->first[e->place[c]] || e->place[c] < e->first[e->place[d]])
                continue;
            for (int k = p->offsets[c], j = p->offsets[d]; k < p->offsets[c + 1] && j < p->offsets[d + 1];)
                if (p->indices[k] == p->indices[j])
                    sum += C.values[k++] * C.values[j++];
                else if (p->indices[k] < p->indices[j])
                    k++;
                else
                    j++;
            if (sum != 0.0)
                *envelope_entry(e, a, c, d) += sum;
        }
    envelope_factor(e, a, 1e-30 * fmax(1.0, linear_largest(C.values, p->entries)));
    memcpy(motion, s->normal, (size_t)s->n * sizeof *motion);
    for (int pass = 0; pass < 4; pass++) {
        if (pass)
            envelope_solve(e, a, motion, motion, work);
        size = linear_norm(motion, s->n);
        for (int c = 0; c < s->n; c++)
            motion[c] /= size;
    }
    arena_release(i, arena);
    return 1 / size;
}

/* Return the mass of the lightest motion that constraints leave, over the masses (l) that their rows hold, with each
   coordinate in units of its own diagonal entry of M + C' masses C. */
double masses_lightest(Instance *i, const double *q, const unsigned char *held, const double *masses)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n;
    const Matrix M = matrix_new(i, &s->mass), C = matrix_new(i, &s->constraint);
    double *motion = arena_alloc(i, n), *zeros = arena_alloc(i, n), *size = arena_alloc(i, n), least;
    memset(zeros, 0, n * sizeof *zeros);
    memset(size, 0, n * sizeof *size);
    constraints_evaluate(i, q, zeros, M.values, C.values, NULL, NULL);
    for (int c = 0; c < s->n; c++) {
        for (int e = C.pattern->offsets[c]; e < C.pattern->offsets[c + 1]; e++) {
            const int r = C.pattern->indices[e];
            C.values[e] *= held[r] ? sqrt(masses[r]) : 0.0;
            size[c] += C.values[e] * C.values[e];
        }
        for (int e = M.pattern->offsets[c]; e < M.pattern->offsets[c + 1]; e++)
            if (M.pattern->indices[e] == c) {
                M.values[e] = s->timed && c == s->n - 1 ? fmax(size[c], 1e-300) : M.values[e]; /* Time needs no mass. */
                size[c] += M.values[e];
            }
        size[c] = sqrt(fmax(size[c], 1e-300));
    }
    for (int c = 0; c < s->n; c++) {
        for (int e = C.pattern->offsets[c]; e < C.pattern->offsets[c + 1]; e++)
            C.values[e] /= size[c];
        for (int e = M.pattern->offsets[c]; e < M.pattern->offsets[c + 1]; e++)
            M.values[e] /= size[c] * size[M.pattern->indices[e]];
    }
    least = (s->n <= DENSE ? find_weakest_motion : find_weakest_of_many)(i, M, C, 1.0, motion);
    arena_release(i, arena);
    return least;
}

Outcome masses_check(Instance *i, const double *q, const unsigned char *held)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), n = (size_t)s->n;
    const Matrix M = matrix_new(i, &s->mass), C = matrix_new(i, &s->constraint);
    double *motion = arena_alloc(i, n), *zeros = arena_alloc(i, n), scale, least;
    Outcome outcome = DONE;
    memset(zeros, 0, n * sizeof *zeros);
    constraints_evaluate(i, q, zeros, M.values, C.values, NULL, NULL);
    for (int e = 0; e < s->constraint.entries; e++)
        C.values[e] *= held[s->constraint.indices[e]];
    /* In an open chain all masses may be small, and there is nothing else to compare them with. */
    scale = fmin(fmax(linear_largest(M.values, s->mass.entries), 1e-300), s->l ? INFINITY : 1.0);
    if (s->timed) /* Time needs no mass. */
        M.values[s->mass.entries - 1] = scale;
    least = (s->n <= DENSE ? find_weakest_motion : find_weakest_of_many)(i, M, C, scale, motion);
    if (!(least > 1e-13)) {
        char free[300] = "";
        for (int c = 0; c < s->n; c++)
            if (fabs(motion[c]) > 0.1 && strlen(free) < 200) {
                strcat(free, *free ? ", " : "");
                strncat(free, s->coordinates[c].name, 80);
            }
        outcome = instance_say(i, UNHELD_BODY,
            "%s: the motion along %s has no mass and no constraint that holds it (singular value %.0e of [M; C] at the "
            "start); a massless body must be held by constraints at both ends: never the last body of an open chain, "
            "never one placed by a joint coordinate alone",
            s->name, *free ? free : "some coordinates", least);
    }
    arena_release(i, arena);
    return outcome;
}
