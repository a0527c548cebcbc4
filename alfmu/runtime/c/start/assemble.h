/* Closes the loops from the start values, and looks for other assemblies near them. */

#ifndef ALFMU_ASSEMBLE_H
#define ALFMU_ASSEMBLE_H

#include "instance.h"

#include "internal_begin.h"

Outcome start_assemble(Instance *i, const unsigned char *held, double *q, double *v);

#include "internal_end.h"

#endif
