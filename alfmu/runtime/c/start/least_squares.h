/* The matrix of the assembly, and corrections of least norm by it. */

#pragma once

#include "instance.h"
#include "scene.h"

/* A sparse matrix. */
typedef struct {
    const Pattern *pattern;
    double *values;
} Matrix;

/* The matrix J of an assembly: derivatives of constraints or gaps, followed by those of the kept start values. */
typedef struct {
    Matrix constraints, ties;
} Rows;

Matrix matrix_new(Instance *i, const Pattern *pattern);
void matrix_times(Matrix a, const double *x, double *y);
void matrix_weigh(Matrix a, const double *rows, const double *columns);

/* Compute y = J x, and x = J' y. */
void rows_times(const Rows *J, const double *x, double *y);

void rows_times_back(const Rows *J, const double *y, double *x);
double rows_squared(Instance *i, const Rows *J, double *a);

/* Find x (n) of least norm that minimises |J x - r|, and lam with x = J' lam. */
void rows_least_multipliers(Instance *i, const Rows *J, const double *r, int most, double *lam, double *x);

void rows_least_correction(Instance *i, const Rows *J, const double *r, int most, double *x);
