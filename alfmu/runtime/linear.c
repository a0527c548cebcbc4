#include "linear.h"

#include <float.h>
#include <math.h>
#include <string.h>

#define SWEEPS 60

static double product(const double *x, const double *y, int count)
{
    double sum = 0.0;
    for (int i = 0; i < count; i++)
        sum += x[i] * y[i];
    return sum;
}

static void rotate(double *x, double *y, int count, double c, double s)
{
    for (int i = 0; i < count; i++) {
        const double before = x[i];
        x[i] = c * before - s * y[i];
        y[i] = s * before + c * y[i];
    }
}

static void swap(double *x, double *y, int count)
{
    rotate(x, y, count, 0.0, 1.0);
    for (int i = 0; i < count; i++)
        x[i] = -x[i];
}

/* Makes two columns orthogonal, as Hestenes (1958) does; returns whether they were not yet. */
static int made_orthogonal(double *x, double *y, int rows, double *vx, double *vy, int columns)
{
    const double xx = product(x, x, rows), yy = product(y, y, rows), xy = product(x, y, rows);
    double ratio, t, c;
    if (fabs(xy) <= DBL_EPSILON * sqrt(xx) * sqrt(yy))
        return 0;
    ratio = (yy - xx) / (2.0 * xy);
    t = (ratio < 0.0 ? -1.0 : 1.0) / (fabs(ratio) + sqrt(1.0 + ratio * ratio));
    c = 1.0 / sqrt(1.0 + t * t);
    rotate(x, y, rows, c, c * t);
    rotate(vx, vy, columns, c, c * t);
    return 1;
}

void singular_values(int rows, int columns, double *a, double *v, double *s)
{
    int moved = 1;
    memset(v, 0, (size_t)columns * (size_t)columns * sizeof *v);
    for (int i = 0; i < columns; i++)
        v[i * columns + i] = 1.0;
    for (int sweep = 0; sweep < SWEEPS && moved; sweep++) {
        moved = 0;
        for (int i = 0; i < columns; i++)
            for (int j = i + 1; j < columns; j++)
                moved |= made_orthogonal(
                    a + i * rows, a + j * rows, rows, v + i * columns, v + j * columns, columns);
    }
    for (int i = 0; i < columns; i++)
        s[i] = norm(a + i * rows, rows);
    for (int i = 0; i < columns; i++) {
        int top = i;
        for (int j = i + 1; j < columns; j++)
            if (s[j] > s[top])
                top = j;
        if (top != i) {
            swap(a + i * rows, a + top * rows, rows);
            swap(v + i * columns, v + top * columns, columns);
            swap(s + i, s + top, 1);
        }
    }
}

size_t least_norm_work(int rows, int columns)
{
    const size_t few = (size_t)(rows < columns ? rows : columns);
    return (size_t)rows * (size_t)columns + few * few + few;
}

void least_norm(int rows, int columns, const double *a, const double *r, double least, double *x, double *work)
{
    const int wide = rows < columns, few = wide ? rows : columns, many = wide ? columns : rows;
    double *u = work, *v = u + rows * columns, *s = v + few * few;
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < columns; j++)
            u[wide ? i * columns + j : j * rows + i] = a[j * rows + i];
    singular_values(many, few, u, v, s);
    memset(x, 0, (size_t)columns * sizeof *x);
    for (int i = 0; i < few && s[i] > least * s[0] && s[i] > 0.0; i++) {
        /* The columns of u are those of U times s. */
        const double *left = wide ? v + i * few : u + i * many, *right = wide ? u + i * many : v + i * few;
        const double part = product(left, r, rows) / (s[i] * s[i]);
        for (int j = 0; j < columns; j++)
            x[j] += part * right[j];
    }
}

double largest(const double *x, int count)
{
    double found = 0.0;
    for (int i = 0; i < count; i++) {
        if (isnan(x[i]))
            return x[i];
        found = fmax(found, fabs(x[i]));
    }
    return found;
}

double norm(const double *x, int count)
{
    return sqrt(product(x, x, count));
}
