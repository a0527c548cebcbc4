/* Closes the loops from the start values, and looks for other assemblies near them. */

#ifndef ALFMU_ASSEMBLE_H
#define ALFMU_ASSEMBLE_H

#include "instance.h"

Outcome start_assemble(Instance *i, const unsigned char *held, double *q, double *v);

#endif
