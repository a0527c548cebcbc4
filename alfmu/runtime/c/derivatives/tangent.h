/* Tangents along a tape. */

#ifndef ALFMU_TANGENT_H
#define ALFMU_TANGENT_H

#include "gradient.h"
#include "record.h"

void tangents_along(Gradient *g, Mark from);

#endif
