/* Adjoints back along a tape. */

#pragma once

#include "gradient.h"
#include "record.h"

#ifndef WITHOUT_DERIVATIVES
void adjoints_along(Gradient *g, Mark from);
#else
static inline void adjoints_along(Gradient *g, Mark from) { (void)g, (void)from; }
#endif
