#include "linear.h"

#include "lanes.h"

#define SWEEPS 60
#define SURE 1e-8 /* share of the largest singular value, below which a rank is uncertain */

static double dot_product(const double *x, const double *y, int count)
{
    double sum = 0.0;
    for (int i = 0; i < count; i++)
        sum += x[i] * y[i];
    return sum;
}

static void rotate_columns(double *x, double *y, int count, double c, double s)
{
    for (int i = 0; i < count; i++) {
        const double before = x[i];
        x[i] = c * before - s * y[i];
        y[i] = s * before + c * y[i];
    }
}

static void swap_columns(double *x, double *y, int count)
{
    rotate_columns(x, y, count, 0.0, 1.0);
    for (int i = 0; i < count; i++)
        x[i] = -x[i];
}

/* Make two columns orthogonal (Hestenes 1958); return whether they were not orthogonal yet. A column whose square is at
   most `noise` is round-off, which never becomes orthogonal. */
static int orthogonalise_columns(double *x, double *y, int rows, double *vx, double *vy, int columns, double noise)
{
    double xx = 0.0, yy = 0.0, xy = 0.0, ratio, t, c;
    for (int i = 0; i < rows; i++) { /* three sums that do not wait for each other */
        xx += x[i] * x[i];
        yy += y[i] * y[i];
        xy += x[i] * y[i];
    }
    if (fmin(xx, yy) <= noise || fabs(xy) <= DBL_EPSILON * sqrt(xx) * sqrt(yy))
        return 0;
    ratio = (yy - xx) / (2.0 * xy);
    t = (ratio < 0.0 ? -1.0 : 1.0) / (fabs(ratio) + sqrt(1.0 + ratio * ratio));
    c = 1.0 / sqrt(1.0 + t * t);
    rotate_columns(x, y, rows, c, c * t);
    rotate_columns(vx, vy, columns, c, c * t);
    return 1;
}

void linear_singular_values(int rows, int columns, double *a, double *v, double *s)
{
    const double noise = DBL_EPSILON * DBL_EPSILON * dot_product(a, a, rows * columns);
    const int turned = v ? columns : 0;
    int moved = 1;
    v = v ? v : s; /* of which nothing is turned */
    memset(v, 0, (size_t)turned * (size_t)turned * sizeof *v);
    for (int i = 0; i < turned; i++)
        v[i * columns + i] = 1.0;
    for (int sweep = 0; sweep < SWEEPS && moved; sweep++) {
        moved = 0;
        for (int i = 0; i < columns; i++)
            for (int j = i + 1; j < columns; j++)
                moved |= orthogonalise_columns(
                    a + i * rows, a + j * rows, rows, v + i * turned, v + j * turned, turned, noise);
    }
    for (int i = 0; i < columns; i++)
        s[i] = linear_norm(a + i * rows, rows);
    for (int i = 0; i < columns; i++) {
        int top = i;
        for (int j = i + 1; j < columns; j++)
            if (s[j] > s[top])
                top = j;
        if (top != i) {
            swap_columns(a + i * rows, a + top * rows, rows);
            swap_columns(v + i * turned, v + top * turned, turned);
            swap_columns(s + i, s + top, 1);
        }
    }
}

void linear_orthogonalise_to(const double *others, int count, int rows, double *column)
{
    for (int j = 0; j < count; j++) {
        const double part = dot_product(others + j * rows, column, rows);
        for (int r = 0; r < rows; r++)
            column[r] -= part * others[j * rows + r];
    }
}

void linear_span(int rows, int columns, int rank, double *a, double *sizes)
{
    for (int k = 0; k < rank && k < columns; k++) {
        double size;
        int top = k;
        for (int j = k; j < columns; j++) {
            if (k > 0)
                linear_orthogonalise_to(a + (k - 1) * rows, 1, rows, a + j * rows);
            sizes[j] = linear_norm(a + j * rows, rows);
            if (sizes[j] > sizes[top])
                top = j;
        }
        if (top != k) {
            swap_columns(a + k * rows, a + top * rows, rows);
            swap_columns(sizes + k, sizes + top, 1);
        }
        linear_orthogonalise_to(a, k, rows, a + k * rows); /* once more, against round-off */
        size = linear_norm(a + k * rows, rows);
        for (int r = 0; r < rows; r++)
            a[k * rows + r] /= size > 0.0 ? size : 1.0;
    }
}

size_t linear_least_norm_work(int rows, int columns)
{
    const size_t few = (size_t)(rows < columns ? rows : columns);
    return (size_t)rows * (size_t)columns + few * few + few;
}

void linear_least_norm(int rows, int columns, const double *a, const double *r, double least, double *x, double *work)
{
    const int wide = rows < columns, few = wide ? rows : columns, many = wide ? columns : rows;
    double *u = work, *v = u + rows * columns, *s = v + few * few;
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < columns; j++)
            u[wide ? i * columns + j : j * rows + i] = a[j * rows + i];
    linear_singular_values(many, few, u, v, s);
    memset(x, 0, (size_t)columns * sizeof *x);
    for (int i = 0; i < few && s[i] > least * s[0] && s[i] > 0.0; i++) {
        /* u holds the columns of U times s. */
        const double *left = wide ? v + i * few : u + i * many, *right = wide ? u + i * many : v + i * few;
        const double part = dot_product(left, r, rows) / (s[i] * s[i]);
        for (int j = 0; j < columns; j++)
            x[j] += part * right[j];
    }
}

int linear_rank_is_sure(int side, double least, const double *work)
{
    const double *s = work + 2 * side * side;
    for (int i = 0; i < side; i++)
        if (s[i] > least * s[0] && s[i] <= SURE * s[0])
            return 0;
    return 1;
}

double linear_largest(const double *x, int count)
{
    double found = 0.0;
    for (int i = 0; i < count; i++) {
        if (isnan(x[i]))
            return x[i];
        found = fmax(found, fabs(x[i]));
    }
    return found;
}

double linear_norm(const double *x, int count)
{
    return sqrt(dot_product(x, x, count));
}

double *envelope_entry(const Envelope *e, double *a, int i, int j)
{
    const int row = e->place[i], column = e->place[j];
    return row > column ? a + e->start[row] + column : a + e->start[column] + row;
}

void envelope_factor(const Envelope *e, double *a, double least)
{
    for (int i = 0; i < e->size; i++) {
        double *row = a + e->start[i], pivot = row[i];
        for (int j = e->first[i]; j < i; j++) {
            const double *above = a + e->start[j];
            const int k = e->first[i] > e->first[j] ? e->first[i] : e->first[j];
            row[j] -= dot_product(row + k, above + k, j - k);
        }
        for (int j = e->first[i]; j < i; j++) {
            const double before = row[j];
            row[j] /= a[e->start[j] + j];
            pivot -= before * row[j];
        }
        row[i] = pivot > least ? pivot : least;
    }
}

void envelope_solve(const Envelope *e, const double *a, const double *b, double *x, double *work)
{
    for (int i = 0; i < e->size; i++)
        work[e->place[i]] = b[i];
    for (int i = 0; i < e->size; i++)
        work[i] -= dot_product(a + e->start[i] + e->first[i], work + e->first[i], i - e->first[i]);
    for (int i = 0; i < e->size; i++)
        work[i] /= a[e->start[i] + i];
    for (int i = e->size; i--;)
        for (int j = e->first[i]; j < i; j++)
            work[j] -= a[e->start[i] + j] * work[i];
    for (int i = 0; i < e->size; i++)
        x[i] = work[e->place[i]];
}

/* Subtract multiples of four rows u of a matrix from a row, in `count` columns. */
static BY_PROCESSOR void subtract_four(
    double *restrict row, const double *l, const double *restrict u, int size, int count)
{
    const double l0 = l[0], l1 = l[1], l2 = l[2], l3 = l[3];
    const double *restrict u1 = u + size, *restrict u2 = u1 + size, *restrict u3 = u2 + size;
    int j = 0;
#if defined(__GNUC__)
    for (; j + 4 <= count; j += 4)
        FOUR(row + j) -= l0 * FOUR(u + j) + l1 * FOUR(u1 + j) + (l2 * FOUR(u2 + j) + l3 * FOUR(u3 + j));
#endif
    for (; j < count; j++)
        row[j] -= l0 * u[j] + l1 * u1[j] + (l2 * u2[j] + l3 * u3[j]);
}

/* Factorise the matrix of s * s blocks (n, n); each block is the sum over terms of a weight (term, row, column) times a
   part (term, row; stored by columns). Rows are in `order`; L, without its unit diagonal, is stored below U. */
void linear_factor(int n, int s, int terms, const double *weights, const double *const *parts, double *a, double *order)
{
    const int size = n * s;
    for (int i = 0; i < s; i++)
        for (int j = 0; j < s; j++)
            for (int r = 0; r < n; r++) {
                double *row = a + (i * n + r) * size + j * n;
                for (int c = 0; c < n; c++)
                    row[c] = weights[i * s + j] * parts[i][c * n + r];
                for (int t = 1; t < terms; t++)
                    for (int c = 0; c < n; c++)
                        row[c] += weights[(t * s + i) * s + j] * parts[t * s + i][c * n + r];
            }
    for (int i = 0; i < size; i++)
        order[i] = i;
    for (int k = 0; k < size; k += 4) {
        /* Factorise four columns. */
        const int end = k + 4 < size ? k + 4 : size;
        for (int p = k; p < end; p++) {
            double most = fabs(a[p * size + p]);
            int largest = p;
            for (int i = p + 1; i < size; i++) {
                const double pivot = fabs(a[i * size + p]);
                if (pivot > most) {
                    most = pivot;
                    largest = i;
                }
            }
            if (largest != p) {
                double kept = order[p];
                order[p] = order[largest];
                order[largest] = kept;
                for (int j = 0; j < size; j++) {
                    kept = a[p * size + j];
                    a[p * size + j] = a[largest * size + j];
                    a[largest * size + j] = kept;
                }
            }
            for (int i = p + 1; i < size; i++) {
                const double by = a[i * size + p] /= a[p * size + p];
                for (int j = p + 1; j < end; j++)
                    a[i * size + j] -= by * a[p * size + j];
            }
        }
        /* Update the rows of these columns to the right, then the remaining rows. */
        for (int p = k; p < end; p++)
            for (int i = p + 1; i < end; i++)
                for (int j = end; j < size; j++)
                    a[i * size + j] -= a[i * size + p] * a[p * size + j];
        if (end - k == 4)
            for (int i = end; i < size; i++)
                subtract_four(a + i * size + end, a + i * size + k, a + k * size + end, size, size - end);
    }
}

void linear_solve(int n, int s, const double *a, const double *order, const double *const *right, double *x)
{
    const int size = n * s;
    for (int i = 0; i < size; i++) {
        const int from = (int)order[i];
        double sum = right[from / n][from % n];
        for (int j = 0; j < i; j++)
            sum -= a[i * size + j] * x[j];
        x[i] = sum;
    }
    for (int i = size - 1; i >= 0; i--) {
        double sum = x[i];
        for (int j = i + 1; j < size; j++)
            sum -= a[i * size + j] * x[j];
        x[i] = sum / a[i * size + i];
    }
}
