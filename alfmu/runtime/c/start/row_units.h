/* The length of a mechanism and the units of its constraints, found from their coefficients. */

#pragma once

#include "instance.h"
#include "layout.h"
#include "scene.h"

/* S1: displacements to positions near the start; the first is zero. */
static const double side_places[] = {0.0, ASIDE};
#define SIDE_PLACES (int)(sizeof side_places / sizeof *side_places)

/* A number at several positions: its value at the start, its least and largest value. */
typedef struct {
    double first, least, most;
} Range;

/* Sum of squares of some coefficients of a row, and their number. */
typedef struct {
    double squares, count;
} Sum;

/* Properties of the coefficients of a row that tell its unit. */
typedef struct {
    Sum lengths, euler;
    double most, constant, constant_length, angular;
} Row_units;

void range_widen(Range *range, double x);
int range_is_constant(Range range);
void units_sample_coefficients(Instance *i, const double *q, double *M, Range *sizes, Range *amplitudes);
void units_tell(const Scene *s, const Range *sizes, const Range *amplitudes, Row_units *told);
double units_own_length(Instance *i, const double *q, double *loop);
double units_constant(const Row_units *row);
int units_are_telling(const Row_units *row, Sum sum);
double units_of_row(const Row_units *row);
