/* Ranks of the constraints: degrees of freedom, redundancy, and the rank that a step freezes. */

#pragma once

#include "instance.h"
#include "least_squares.h"

void rank_weighted_rows(Instance *i, const double *q, const double *weights, Matrix C, double *phi);
int rank_at(Instance *i, const double *q, const unsigned char *held);
void rank_correction(Instance *i, const Rows *J, const double *r, double *x);
void rank_freeze(Instance *i);
int rank_freedom_near(Instance *i, const double *q, const unsigned char *held, int *here, double *place);
int rank_changes_near(Instance *i, const double *q, const double *v);
Outcome instance_mobility(Instance *i, Counted_rows which, int *freedom, int *redundant, int *here, double *place);
