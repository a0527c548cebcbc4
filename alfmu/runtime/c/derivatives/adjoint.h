/* Adjoints back along a tape. */

#ifndef ALFMU_ADJOINT_H
#define ALFMU_ADJOINT_H

#include "gradient.h"
#include "record.h"

#include "internal_begin.h"

#ifndef WITHOUT_DERIVATIVES
void adjoints_along(Gradient *g, Mark from);
#else
static inline void adjoints_along(Gradient *g, Mark from) { (void)g, (void)from; }
#endif

#include "internal_end.h"

#endif
