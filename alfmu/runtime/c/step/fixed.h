/* Internal RK4 steps of fixed length, by the tiers quick, careful and branch. */

#pragma once

#include "instance.h"

int run_is_ended(Instance *i);
int step_can_reuse(const Instance *i);
int step_reuse_is_near(const Instance *i);
void step_commit(Instance *i);
long step_fixed(Instance *i, long steps, double dt);
int step_fixed_whole(Instance *i, double start, double h, long *made);
