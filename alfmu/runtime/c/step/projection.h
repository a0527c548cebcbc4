/* Projections (10) onto the constraints, by loops that stop on convergence. */

#pragma once

#include "instance.h"

int projection_is_closed(Instance *i, const double *residue, const double *C, const double *q, const double *v);
Outcome projection_apply(Instance *i, double *q, double *v);
Outcome projection_close(Instance *i, double t);
void projection_watch_gaps(Instance *i);
