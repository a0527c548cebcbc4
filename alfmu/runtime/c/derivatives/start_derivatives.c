/* Derivatives of the start: of each Gauss-Newton step that closed the loops, and of the corrections that made
   velocities consistent.

   A step x = J+ r with x = J' lam has the differential dx = J+ (dr - dJ x) + (1 - J+ J) dJ' lam. A remaining error lies
   in the row space of J, and the last step, at closed loops, removes it. Both terms are corrections of least norm, with
   the ranks of the start. */

#include "start_derivatives.h"

#include "function_adjoints.h"
#include "function_tangents.h"
#include "gradient.h"
#include "instance.h"
#include "lanes.h"
#include "layout.h"
#include "least_squares.h"
#include "linear.h"
#include "record.h"
#include "scene.h"

/* A correction, read from the tape. */
typedef struct {
    const int32_t *places;
    const double *closure, *constraints, *rows, *columns, *x, *lam;
    double part;
} Correction;

static Correction read_correction(const Gradient *g, const Entry *e)
{
    const Scene *s = g->instance->scene;
    const double *at = g->tape->numbers + e->numbers;
    Correction c = {g->tape->words + e->words, at, NULL, NULL, NULL, NULL, NULL, 0.0};
    at += arguments_of(s->functions + s->closure);
    if (e->kind == RATED) {
        c.constraints = at;
        at += arguments_of(s->functions + s->constraints);
    }
    c.rows = at;
    c.columns = c.rows + s->l + s->ties;
    c.x = c.columns + s->n;
    c.lam = c.x + s->n;
    c.part = c.lam[s->l + s->ties];
    return c;
}

/* Return the offset of a result among all results of a function. */
static size_t result_offset(const Function *f, int which)
{
    size_t count = 0;
    for (int j = 0; j < which; j++)
        count += (size_t)f->lengths[f->inputs + j];
    return count;
}

/* Results of `closure`: gaps' and ties' matrices, their residues. Of `constraints`: M, C, Phi, C v. */
enum { GAPS, TIES, GAP_LEFT, TIES_LEFT };
enum { OF_MASS, OF_C, OF_PHI, OF_CV };

/* Fill the rows of J from registers: results of a function from `which` on, with weights. */
static void fill_rows(
    const Function *f, int which, const double *r, const double *rows, const double *columns, Matrix a)
{
    const size_t from = result_offset(f, which);
    for (int e = 0; e < a.pattern->entries; e++)
        a.values[e] = r[function_result_place(f, from + (size_t)e)];
    matrix_weigh(a, rows, columns);
}

/* Load the tangents of a function's arguments from `places`, and propagate them through its registers. */
static void lead_tangents(Gradient *g, int which, const double *r, const int32_t *places, const Lanes *t)
{
    const Function *f = g->instance->scene->functions + which;
    const Flat *flat = gradient_flat(g, which);
    Lanes *d = g->lane_registers + g->instance->scene->constant_count;
    for (int j = 0; j < f->inputs; d += f->lengths[j++])
        if (places[j] < 0)
            memset(d, 0, (size_t)f->lengths[j] * sizeof *d);
        else
            memcpy(d, t + places[j], (size_t)f->lengths[j] * sizeof *d);
    if (flat)
        tangents_through(flat, r, g->lane_registers);
}

/* Add the adjoints of a function's arguments at `places`; those of its results are in `g->registers`. */
static void lead_adjoints(Gradient *g, int which, const double *r, const int32_t *places)
{
    const Function *f = g->instance->scene->functions + which;
    const Flat *flat = gradient_flat(g, which);
    const double *d = g->registers + g->instance->scene->constant_count;
    if (flat)
        adjoints_through(flat, r, g->registers);
    for (int j = 0; j < f->inputs; d += f->lengths[j++])
        for (int e = 0; places[j] >= 0 && e < f->lengths[j]; e++)
            g->adjoints[places[j] + e] += d[e];
}

static void clear_registers(Gradient *g, int which)
{
    const Scene *s = g->instance->scene;
    memset(g->registers + s->constant_count, 0,
        (size_t)(s->functions[which].registers - s->constant_count) * sizeof *g->registers);
}

/* Differentiate x = J+ r along one direction; `right` is dr - dJ x, `row` is dJ' lam. */
static void differentiate_least_norm(Instance *i, const Rows *J, double *right, const double *row, double *dx)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i), count = (size_t)(s->l + s->ties);
    double *made = arena_alloc(i, count), *lam = arena_alloc(i, count);
    rows_times(J, row, made);
    for (size_t k = 0; k < count; k++)
        right[k] -= made[k];
    rows_least_multipliers(i, J, right, CORRECTIONS, lam, dx);
    for (int c = 0; c < s->n; c++)
        dx[c] += row[c];
    arena_release(i, arena);
}

/* Add the effect of a change of a matrix, given by its nonzeros in one lane: right -= dA x, row += dA' lam. */
static void add_row_changes(const Function *f, int which, const Lanes *dr, int lane, const Pattern *p,
    const double *rows, const double *columns, const double *x, const double *lam, double *right, double *row)
{
    const size_t from = result_offset(f, which);
    for (int c = 0; c < p->columns; c++)
        for (int e = p->offsets[c]; e < p->offsets[c + 1]; e++) {
            const int r = p->indices[e];
            const double d = dr[function_result_place(f, from + (size_t)e)].lane[lane] * rows[r] * columns[c];
            right[r] -= d * x[c];
            row[c] += d * lam[r];
        }
}

/* Return J for positions: rows of the gaps and of the ties, from the registers of the closure. */
static Rows make_position_rows(Instance *i, const Correction *k, const double *r)
{
    const Scene *s = i->scene;
    const Rows J = {matrix_new(i, &s->gaps), matrix_new(i, &s->tie_rows)};
    fill_rows(s->functions + s->closure, GAPS, r, k->rows, k->columns, J.constraints);
    fill_rows(s->functions + s->closure, TIES, r, k->rows + s->l, k->columns, J.ties);
    return J;
}

void closed_tangents(Gradient *g, const Entry *e)
{
    Instance *i = g->instance;
    const Scene *s = i->scene;
    const Function *f = s->functions + s->closure;
    const Correction k = read_correction(g, e);
    const size_t arena = arena_mark(i), count = (size_t)(s->l + s->ties), n = (size_t)s->n;
    double *right = arena_alloc(i, count), *row = arena_alloc(i, n), *dx = arena_alloc(i, n);
    const double *r = gradient_values_again(g, s->closure, k.closure);
    const Rows J = make_position_rows(i, &k, r);
    const size_t left = result_offset(f, GAP_LEFT), ties_left = result_offset(f, TIES_LEFT);
    for (int block = 0; block < g->blocks; block++) {
        Lanes *t = g->tangents + (size_t)block * g->places;
        lead_tangents(g, s->closure, r, k.places, t);
        for (int lane = 0; lane < LANES; lane++) {
            memset(row, 0, n * sizeof *row);
            for (int j = 0; j < s->l; j++)
                right[j] = k.rows[j] * g->lane_registers[function_result_place(f, left + (size_t)j)].lane[lane];
            for (int j = 0; j < s->ties; j++)
                right[s->l + j] = k.rows[s->l + j]
                    * g->lane_registers[function_result_place(f, ties_left + (size_t)j)].lane[lane];
            add_row_changes(f, GAPS, g->lane_registers, lane, &s->gaps, k.rows, k.columns, k.x, k.lam, right, row);
            add_row_changes(f, TIES, g->lane_registers, lane, &s->tie_rows, k.rows + s->l, k.columns, k.x,
                k.lam + s->l, right + s->l, row);
            differentiate_least_norm(i, &J, right, row, dx);
            for (int c = 0; c < s->n; c++)
                t[k.places[PLACE_Q] + c].lane[lane] -= k.part * k.columns[c] * dx[c];
        }
    }
    arena_release(i, arena);
}

/* Add the adjoints of a matrix's nonzeros to the registers: from the right-hand side by w, from the rows by z. */
static void add_matrix_adjoints(const Function *f, int which, double *ar, const Pattern *p, const double *rows,
    const double *columns, const double *x, const double *lam, const double *w, const double *z)
{
    const size_t from = result_offset(f, which);
    for (int c = 0; c < p->columns; c++)
        for (int e = p->offsets[c]; e < p->offsets[c + 1]; e++) {
            const int r = p->indices[e];
            ar[function_result_place(f, from + (size_t)e)] += rows[r] * columns[c] * (lam[r] * z[c] - w[r] * x[c]);
        }
}

/* Compute w = J+' y and z = (1 - J+ J) y. */
static void split_adjoint(Instance *i, const Rows *J, const double *y, double *w, double *z)
{
    const Scene *s = i->scene;
    const size_t arena = arena_mark(i);
    double *made = arena_alloc(i, (size_t)(s->l + s->ties)), *x = arena_alloc(i, (size_t)s->n);
    rows_times(J, y, made);
    rows_least_multipliers(i, J, made, CORRECTIONS, w, x);
    for (int c = 0; c < s->n; c++)
        z[c] = y[c] - x[c];
    arena_release(i, arena);
}

void closed_adjoints(Gradient *g, const Entry *e)
{
    Instance *i = g->instance;
    const Scene *s = i->scene;
    const Function *f = s->functions + s->closure;
    const Correction k = read_correction(g, e);
    const size_t arena = arena_mark(i), count = (size_t)(s->l + s->ties), n = (size_t)s->n;
    double *w = arena_alloc(i, count), *z = arena_alloc(i, n), *y = arena_alloc(i, n);
    const double *r = gradient_values_again(g, s->closure, k.closure);
    const Rows J = make_position_rows(i, &k, r);
    const size_t left = result_offset(f, GAP_LEFT), ties_left = result_offset(f, TIES_LEFT);
    for (int c = 0; c < s->n; c++)
        y[c] = -k.part * k.columns[c] * g->adjoints[k.places[PLACE_Q] + c];
    split_adjoint(i, &J, y, w, z);
    clear_registers(g, s->closure);
    for (int j = 0; j < s->l; j++)
        g->registers[function_result_place(f, left + (size_t)j)] += k.rows[j] * w[j];
    for (int j = 0; j < s->ties; j++)
        g->registers[function_result_place(f, ties_left + (size_t)j)] += k.rows[s->l + j] * w[s->l + j];
    add_matrix_adjoints(f, GAPS, g->registers, &s->gaps, k.rows, k.columns, k.x, k.lam, w, z);
    add_matrix_adjoints(
        f, TIES, g->registers, &s->tie_rows, k.rows + s->l, k.columns, k.x, k.lam + s->l, w + s->l, z);
    lead_adjoints(g, s->closure, r, k.places);
    arena_release(i, arena);
}

/* Return J for velocities: C from the constraints, and the ties from the closure. */
static Rows make_rate_rows(Gradient *g, const Correction *k)
{
    Instance *i = g->instance;
    const Scene *s = i->scene;
    const Rows J = {matrix_new(i, &s->constraint), matrix_new(i, &s->tie_rows)};
    fill_rows(s->functions + s->closure, TIES, gradient_values_again(g, s->closure, k->closure), k->rows + s->l,
        k->columns, J.ties);
    fill_rows(s->functions + s->constraints, OF_C, gradient_values_again(g, s->constraints, k->constraints), k->rows,
        k->columns, J.constraints);
    return J;
}

/* Return the velocities before a correction, divided by the weights of their columns. */
static const double *find_scaled_rates(Instance *i, const Correction *k)
{
    const double *v = k->constraints + i->scene->n;
    double *scaled = arena_alloc(i, (size_t)i->scene->n);
    for (int c = 0; c < i->scene->n; c++)
        scaled[c] = v[c] / k->columns[c];
    return scaled;
}

/* Differentiate a correction of velocities, whose right-hand side is -C v - Phi_t for the constraints and the
   residue of the rates for the ties. */
void rated_tangents(Gradient *g, const Entry *e)
{
    Instance *i = g->instance;
    const Scene *s = i->scene;
    const Function *closure = s->functions + s->closure, *constraints = s->functions + s->constraints;
    const Correction k = read_correction(g, e);
    const size_t arena = arena_mark(i), count = (size_t)(s->l + s->ties), n = (size_t)s->n;
    const Rows J = make_rate_rows(g, &k);
    const int32_t of_constraints[] = {k.places[PLACE_Q], k.places[PLACE_V], k.places[PLACE_P]};
    const double *v = find_scaled_rates(i, &k);
    double *rights = arena_alloc(i, count * LANES), *rows = arena_alloc(i, n * LANES), *dx = arena_alloc(i, n),
           *dv = arena_alloc(i, n);
    double *of_ties = arena_alloc(i, count);
    const size_t cv = result_offset(constraints, OF_CV);
    for (int block = 0; block < g->blocks; block++) {
        Lanes *t = g->tangents + (size_t)block * g->places;
        memset(rows, 0, n * LANES * sizeof *rows);
        memset(rights, 0, count * LANES * sizeof *rights);
        lead_tangents(g, s->closure, gradient_values_again(g, s->closure, k.closure), k.places, t);
        for (int lane = 0; lane < LANES; lane++) {
            double *right = rights + lane * (int)count + s->l, *unused = dx;
            add_row_changes(closure, TIES, g->lane_registers, lane, &s->tie_rows, k.rows + s->l, k.columns, v,
                k.lam + s->l, right, unused);
            add_row_changes(closure, TIES, g->lane_registers, lane, &s->tie_rows, k.rows + s->l, k.columns, k.x,
                k.lam + s->l, right, rows + lane * s->n);
            for (int c = 0; c < s->n; c++)
                dv[c] = t[k.places[PLACE_V] + c].lane[lane] / k.columns[c];
            rows_times(&J, dv, of_ties);
            for (int j = 0; j < s->ties; j++)
                right[j]
                    += k.rows[s->l + j] * t[k.places[PLACE_RATES] + s->tied[j]].lane[lane] - of_ties[s->l + j];
        }
        lead_tangents(g, s->constraints, gradient_values_again(g, s->constraints, k.constraints), of_constraints, t);
        for (int lane = 0; lane < LANES; lane++) {
            double *right = rights + lane * (int)count, *row = rows + lane * s->n;
            for (int j = 0; j < s->l; j++)
                right[j]
                    -= k.rows[j] * g->lane_registers[function_result_place(constraints, cv + (size_t)j)].lane[lane];
            add_row_changes(
                constraints, OF_C, g->lane_registers, lane, &s->constraint, k.rows, k.columns, k.x, k.lam, right, row);
            differentiate_least_norm(i, &J, right, row, dx);
            for (int c = 0; c < s->n; c++)
                t[k.places[PLACE_V] + c].lane[lane] += k.columns[c] * dx[c];
        }
    }
    arena_release(i, arena);
}

void rated_adjoints(Gradient *g, const Entry *e)
{
    Instance *i = g->instance;
    const Scene *s = i->scene;
    const Function *closure = s->functions + s->closure, *constraints = s->functions + s->constraints;
    const Correction k = read_correction(g, e);
    const size_t arena = arena_mark(i), count = (size_t)(s->l + s->ties), n = (size_t)s->n;
    const Rows J = make_rate_rows(g, &k);
    const int32_t of_constraints[] = {k.places[PLACE_Q], k.places[PLACE_V], k.places[PLACE_P]};
    const double *v = find_scaled_rates(i, &k), *r;
    double *w = arena_alloc(i, count), *z = arena_alloc(i, n), *y = arena_alloc(i, n), *none = arena_alloc(i, n),
           *back = arena_alloc(i, n);
    const size_t cv = result_offset(constraints, OF_CV);
    for (int c = 0; c < s->n; c++)
        y[c] = k.columns[c] * g->adjoints[k.places[PLACE_V] + c];
    memset(none, 0, n * sizeof *none);
    split_adjoint(i, &J, y, w, z);
    for (int j = 0; j < s->ties; j++)
        g->adjoints[k.places[PLACE_RATES] + s->tied[j]] += k.rows[s->l + j] * w[s->l + j];
    /* Differentiate the product T v of the ties here; C v is a result of the constraints. */
    {
        double *of_ties = arena_alloc(i, count);
        memset(of_ties, 0, count * sizeof *of_ties);
        memcpy(of_ties + s->l, w + s->l, (size_t)s->ties * sizeof *of_ties);
        rows_times_back(&J, of_ties, back);
        for (int c = 0; c < s->n; c++)
            g->adjoints[k.places[PLACE_V] + c] -= back[c] / k.columns[c];
    }
    r = gradient_values_again(g, s->constraints, k.constraints);
    clear_registers(g, s->constraints);
    for (int j = 0; j < s->l; j++)
        g->registers[function_result_place(constraints, cv + (size_t)j)] -= k.rows[j] * w[j];
    add_matrix_adjoints(constraints, OF_C, g->registers, &s->constraint, k.rows, k.columns, k.x, k.lam, w, z);
    lead_adjoints(g, s->constraints, r, of_constraints);
    r = gradient_values_again(g, s->closure, k.closure);
    clear_registers(g, s->closure);
    add_matrix_adjoints(
        closure, TIES, g->registers, &s->tie_rows, k.rows + s->l, k.columns, k.x, k.lam + s->l, w + s->l, z);
    add_matrix_adjoints(
        closure, TIES, g->registers, &s->tie_rows, k.rows + s->l, k.columns, v, k.lam + s->l, w + s->l, none);
    lead_adjoints(g, s->closure, r, k.places);
    arena_release(i, arena);
}

/* A frozen rank, read from the tape: roots of relative penalties, and b, v and sizes of tape_holding. */
typedef struct {
    int32_t places[3];
    int32_t matrix;
    const double *penalty, *values;
    double largest, *root, *b, *v, *sizes;
} Holding;

static Holding read_holding(Gradient *g, const Entry *e)
{
    Instance *i = g->instance;
    const Scene *s = i->scene;
    const Function *f = s->functions + s->constraints;
    const int32_t *words = g->tape->words + e->words;
    const double *arguments = g->tape->numbers + e->numbers;
    const Pattern *p = &s->constraint;
    const size_t l = (size_t)s->l, n = (size_t)s->n, from = result_offset(f, OF_C);
    Holding h = {{words[0], -1, words[1]}, words[2], arguments + arguments_of(f), NULL, 0.0, NULL, NULL, NULL, NULL};
    h.largest = h.penalty[l];
    h.root = arena_alloc(i, l);
    h.b = arena_alloc(i, n * l);
    h.v = arena_alloc(i, l * l);
    h.sizes = arena_alloc(i, l);
    h.values = gradient_values_again(g, s->constraints, arguments);
    for (int r = 0; r < s->l; r++)
        h.root[r] = sqrt(h.penalty[r]);
    memset(h.b, 0, n * l * sizeof *h.b);
    for (int c = 0; c < s->n; c++)
        for (int k = p->offsets[c]; k < p->offsets[c + 1]; k++)
            h.b[p->indices[k] * s->n + c]
                = h.root[p->indices[k]] * h.values[function_result_place(f, from + (size_t)k)];
    linear_singular_values(s->n, s->l, h.b, h.v, h.sizes);
    return h;
}

void held_tangents(Gradient *g, const Entry *e)
{
    Instance *i = g->instance;
    const Scene *s = i->scene;
    const Function *f = s->functions + s->constraints;
    const Pattern *p = &s->constraint;
    const size_t arena = arena_mark(i), l = (size_t)s->l, n = (size_t)s->n, from = result_offset(f, OF_C);
    const int rank = e->what;
    const Holding h = read_holding(g, e);
    double *turned = arena_alloc(i, n * l), *dP = arena_alloc(i, l * l);
    for (int block = 0; block < g->blocks; block++) {
        Lanes *t = g->tangents + (size_t)block * g->places;
        lead_tangents(g, s->constraints, h.values, h.places, t);
        for (int lane = 0; lane < LANES; lane++) {
            memset(turned, 0, n * l * sizeof *turned); /* dA v, by columns */
            memset(dP, 0, l * l * sizeof *dP);
            for (int c = 0; c < s->n; c++)
                for (int k = p->offsets[c]; k < p->offsets[c + 1]; k++) {
                    const int r = p->indices[k];
                    const double d
                        = h.root[r] * g->lane_registers[function_result_place(f, from + (size_t)k)].lane[lane];
                    for (int j = 0; j < s->l && d != 0.0; j++)
                        turned[j * s->n + c] += d * h.v[j * s->l + r];
                }
            for (int k = 0; k < rank; k++)
                for (int j = rank; j < s->l; j++) {
                    double by = 0.0;
                    for (int c = 0; c < s->n; c++)
                        by += h.b[k * s->n + c] * turned[j * s->n + c] + h.b[j * s->n + c] * turned[k * s->n + c];
                    by /= h.sizes[k] * h.sizes[k] - h.sizes[j] * h.sizes[j];
                    for (int a = 0; a < s->l; a++)
                        for (int b = 0; b < s->l; b++)
                            dP[a * s->l + b] += by
                                * (h.v[j * s->l + a] * h.v[k * s->l + b] + h.v[k * s->l + a] * h.v[j * s->l + b]);
                }
            for (int a = 0; a < s->l; a++)
                for (int b = 0; b < s->l; b++)
                    t[h.matrix + a * s->l + b].lane[lane] = h.root[a] * dP[a * s->l + b] * h.root[b] / h.largest;
        }
    }
    arena_release(i, arena);
}

void held_adjoints(Gradient *g, const Entry *e)
{
    Instance *i = g->instance;
    const Scene *s = i->scene;
    const Function *f = s->functions + s->constraints;
    const Pattern *p = &s->constraint;
    const size_t arena = arena_mark(i), l = (size_t)s->l, n = (size_t)s->n, from = result_offset(f, OF_C);
    const int rank = e->what;
    const Holding h = read_holding(g, e);
    double *of_P = arena_alloc(i, l * l), *of_A = arena_alloc(i, n * l);
    memset(of_A, 0, n * l * sizeof *of_A);
    for (int a = 0; a < s->l; a++)
        for (int b = 0; b < s->l; b++) {
            double *own = g->adjoints + h.matrix + a * s->l + b;
            of_P[a * s->l + b] = h.root[a] * *own * h.root[b] / h.largest;
            *own = 0.0;
        }
    for (int k = 0; k < rank; k++)
        for (int j = rank; j < s->l; j++) {
            double by = 0.0;
            for (int a = 0; a < s->l; a++)
                for (int b = 0; b < s->l; b++)
                    by += of_P[a * s->l + b]
                        * (h.v[j * s->l + a] * h.v[k * s->l + b] + h.v[k * s->l + a] * h.v[j * s->l + b]);
            by /= h.sizes[k] * h.sizes[k] - h.sizes[j] * h.sizes[j];
            for (int r = 0; r < s->l; r++)
                for (int c = 0; c < s->n; c++)
                    of_A[r * s->n + c] +=
                        by * (h.v[j * s->l + r] * h.b[k * s->n + c] + h.v[k * s->l + r] * h.b[j * s->n + c]);
        }
    clear_registers(g, s->constraints);
    for (int c = 0; c < s->n; c++)
        for (int k = p->offsets[c]; k < p->offsets[c + 1]; k++)
            g->registers[function_result_place(f, from + (size_t)k)]
                += h.root[p->indices[k]] * of_A[p->indices[k] * s->n + c];
    lead_adjoints(g, s->constraints, h.values, h.places);
    arena_release(i, arena);
}
