/* Tangents along a tape. */

#pragma once

#include "gradient.h"
#include "record.h"

void tangents_along(Gradient *g, Mark from);
