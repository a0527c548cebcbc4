/* Linear algebra: small dense matrices, stored by columns, and sparse symmetric ones within an envelope. */

#pragma once

#include "baseline.h"

/* Envelope of the lower half of a sparse symmetric matrix and of its factors: the order of the rows keeps entries near
   the diagonal, and each row is stored from its first entry on. */
typedef struct {
    int size;
    const int *place;       /* [size] position of each unknown in the order */
    const int *first;       /* [size] first entry of each row, by position */
    const ptrdiff_t *start; /* [size] index where entry (row, 0) of each row would be */
    size_t entries;
} Envelope;

/* Compute the singular values s, largest first, of a = U S V'. The columns of a (rows x columns) become those of U
   times s; v is columns x columns, or NULL. */
void linear_singular_values(int rows, int columns, double *a, double *v, double *s);

/* Make a column (rows) orthogonal to `count` others of length one. */
void linear_orthogonalise_to(const double *others, int count, int rows, double *column);

/* Replace the first `rank` columns of a matrix (rows, columns), stored by columns, by ones of length one that are
   orthogonal to each other and span it, the largest first; `sizes` (columns) are the lengths that they had after those
   before them were taken out (Gram and Schmidt, with pivots). */
void linear_span(int rows, int columns, int rank, double *a, double *sizes);

size_t linear_least_norm_work(int rows, int columns);

/* Find x (columns) of least norm that minimises |a x - r|, without singular values below `least` of the largest. `work`
   holds least_norm_work(rows, columns) numbers. */
void linear_least_norm(int rows, int columns, const double *a, const double *r, double least, double *x, double *work);

/* Return whether the rank found last survives a small change of the square matrix; below the root of round-off a
   derivative has no digit left. */
int linear_rank_is_sure(int side, double least, const double *work);

/* Return the largest |x[i]|: 0 if there is none, NaN if one is NaN. */
double linear_largest(const double *x, int count);

/* The Euclidean norm. */
double linear_norm(const double *x, int count);

double *envelope_entry(const Envelope *e, double *a, int i, int j);

/* Factorise a = L D L' in place; pivots that are not positive become `least`. */
void envelope_factor(const Envelope *e, double *a, double least);

/* Solve L D L' x = b; x and b may be the same array. `work` holds `size` numbers. */
void envelope_solve(const Envelope *e, const double *a, const double *b, double *x, double *work);

/* Factorise a matrix of s * s blocks (n, n), and solve with its factors. */
void linear_factor(
    int n, int s, int terms, const double *weights, const double *const *parts, double *a, double *order);

void linear_solve(int n, int s, const double *a, const double *order, const double *const *right, double *x);
