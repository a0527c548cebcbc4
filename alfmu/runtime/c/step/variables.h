/* Checking, setting and getting values of variables by reference. */

#pragma once

#include "instance.h"
#include "scene.h"

Outcome variable_check(Instance *i, const Variable *v, double value);
Outcome check_changeable(Instance *i, const Variable *v);
void variable_changed_start(Instance *i, int changed);
Outcome variable_set_choice(Instance *i, int reference, double value);
Outcome variable_set_switch(Instance *i, int reference, double value);
Outcome instance_stabilise(Instance *i, double zeta, double omega, int projection);
Outcome instance_set_slope(Instance *i, int reference, double value);
const double *instance_place(const Instance *i, int reference);
double instance_get(const Instance *i, int reference);
void instance_get_many(const Instance *i, const int *references, int count, double *values);
