/* Adjoints back along a tape. */

#ifndef ALFMU_ADJOINT_H
#define ALFMU_ADJOINT_H

#include "gradient.h"
#include "record.h"

#include "internal_begin.h"

void adjoints_along(Gradient *g, Mark from);

#include "internal_end.h"

#endif
