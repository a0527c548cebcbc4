/* The start of a run: assembly, penalties and settings. */

#pragma once

#include "instance.h"

Outcome instance_initialize(Instance *i);
Outcome instance_begin(Instance *i, double start, double stop);
