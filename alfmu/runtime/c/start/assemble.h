/* Closes the loops from the start values, and looks for other assemblies near them. */

#pragma once

#include "instance.h"

Outcome start_assemble(Instance *i, const unsigned char *held, double *q, double *v);
