/* Small dense linear algebra; matrices are stored column by column. */

#ifndef ALFMU_LINEAR_H
#define ALFMU_LINEAR_H

#include <stddef.h>

/* Also where an importer compiles this: other libraries have such names too (glibc: advance). */
#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility push(hidden)
#endif

/* a = U S V': on return the columns of a (rows x columns) are those of U times s, largest first; v is columns x
   columns. */
void singular_values(int rows, int columns, double *a, double *v, double *s);

/* x (columns) of least norm with a x = r as nearly as possible, singular values below `least` of the largest left
   alone. `work` holds least_norm_work(rows, columns) numbers. */
void least_norm(int rows, int columns, const double *a, const double *r, double least, double *x, double *work);
size_t least_norm_work(int rows, int columns);

/* The largest |x[i]|, 0 where there is none; not a number where one is not. */
double largest(const double *x, int count);

/* The Euclidean norm. */
double norm(const double *x, int count);

/* Factors of the matrix of blocks * blocks parts (n, n), and a solution by them. */
void factor(int n, int blocks, int terms, const double *weights, const double *const *parts, double *a, double *order);
void solve(int n, int blocks, const double *a, const double *order, const double *const *right, double *x);

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility pop
#endif

#endif
