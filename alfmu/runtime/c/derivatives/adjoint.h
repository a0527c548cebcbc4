/* Adjoints back along a tape. */

#ifndef ALFMU_ADJOINT_H
#define ALFMU_ADJOINT_H

#include "gradient.h"
#include "record.h"

void adjoints_along(Gradient *g, Mark from);

#endif
