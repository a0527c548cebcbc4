/* Derivatives of the start: of the assembly, the start velocities and a frozen rank. */

#pragma once

#include "gradient.h"
#include "record.h"

void closed_tangents(Gradient *g, const Entry *e);
void closed_adjoints(Gradient *g, const Entry *e);
void rated_tangents(Gradient *g, const Entry *e);
void rated_adjoints(Gradient *g, const Entry *e);
void held_tangents(Gradient *g, const Entry *e);
void held_adjoints(Gradient *g, const Entry *e);
