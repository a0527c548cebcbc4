/* Linear algebra: small dense matrices, stored by columns, and sparse symmetric ones within an envelope. */

#ifndef ALFMU_LINEAR_H
#define ALFMU_LINEAR_H

#include <stddef.h>

#include "internal_begin.h"

/* Envelope of the lower half of a sparse symmetric matrix and of its factors: rows in an order that keeps the
   entries of each near its diagonal, each row from its first entry on. */
typedef struct {
    int size;
    const int *place;       /* [size] of each unknown in the order */
    const int *first;       /* [size] entry of each row, by place */
    const ptrdiff_t *start; /* [size] where entry (row, 0) of each row would stand */
    size_t entries;
} Envelope;

/* a = U S V': on return the columns of a (rows x columns) are those of U times s, largest first; v is columns x
   columns. */
void linear_singular_values(int rows, int columns, double *a, double *v, double *s);

size_t linear_least_norm_work(int rows, int columns);

/* x (columns) of least norm with a x = r as nearly as possible, singular values below `least` of the largest left
   alone. `work` holds least_norm_work(rows, columns) numbers. */
void linear_least_norm(int rows, int columns, const double *a, const double *r, double least, double *x, double *work);

/* Return whether the rank found last survives a small change of the square matrix: below the root of round-off no
   digit of a derivative is left. */
int linear_rank_is_sure(int side, double least, const double *work);

/* The largest |x[i]|, 0 where there is none; not a number where one is not. */
double linear_largest(const double *x, int count);

/* The Euclidean norm. */
double linear_norm(const double *x, int count);

double *envelope_entry(const Envelope *e, double *a, int i, int j);

/* Factorise a = L D L' in place; pivots that are not above zero become `least`. */
void envelope_factor(const Envelope *e, double *a, double least);

/* x with L D L' x = b; x and b may be the same. `work` holds `size` numbers. */
void envelope_solve(const Envelope *e, const double *a, const double *b, double *x, double *work);

/* Factors of the matrix of blocks * blocks parts (n, n), and a solution by them. */
void linear_factor(
    int n, int s, int terms, const double *weights, const double *const *parts, double *a, double *order);

void linear_solve(int n, int s, const double *a, const double *order, const double *const *right, double *x);

#include "internal_end.h"

#endif
