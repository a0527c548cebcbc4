/* Adjoints back along a tape. */

#pragma once

#include "gradient.h"
#include "record.h"

void adjoints_along(Gradient *g, Mark from);
