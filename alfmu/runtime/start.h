/* The matrix of an assembly, which the start (start.c) and its derivatives (closing.c) share. */

#ifndef ALFMU_START_H
#define ALFMU_START_H

#include "alfmu.h"

#define QUANTITY 64 /* characters */

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility push(hidden)
#endif

/* A matrix of nonzeros. */
typedef struct {
    const Pattern *pattern;
    double *values;
} Matrix;

/* The matrix J of an assembly: derivatives of constraints or gaps, and below them of the start values that are kept. */
typedef struct {
    Matrix constraints, ties;
} Rows;

/* A value with its unit, an angle in degrees, too. */
const char *in_unit(const char *unit, double value, char *text);

Matrix matrix_new(Instance *i, const Pattern *pattern);

/* y = J x, and x = J' y */
void all_times(const Rows *J, const double *x, double *y);
void all_times_back(const Rows *J, const double *y, double *x);

/* x (n) of least norm with J x = r as nearly as possible, and lam with x = J' lam. */
void least_multipliers(Instance *i, const Rows *J, const double *r, int most, double *lam, double *x);

/* What an entry of a tape says of a step of the assembly, and of a correction of its velocities. */
void tape_closing(Instance *i, const unsigned char *held, const double *q, const double *dq, const double *lam, double part);
void tape_rating(Instance *i, const unsigned char *held, const double *q, const double *v, const double *dv, const double *lam);

/* The same of constraints that are combined to those of a frozen rank, at q. */
void tape_holding(Instance *i, const double *q, const double *matrix);

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility pop
#endif

#endif
