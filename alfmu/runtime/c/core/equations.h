/* Constraints and energies of an instance at any position and velocity. */

#pragma once

#include "instance.h"
#include "scene.h"

void pattern_spread(const Pattern *pattern, const double *values, double *dense, int rows);
void constraints_evaluate(
    Instance *i, const double *q, const double *v, double *mass, double *matrix, double *phi, double *cv);
double constraints_widest(Instance *i, const double *q, const double *v, int of_velocity, int *row);
double energy_evaluate(Instance *i, const double *v, double *kinetic);
void energy_record(Instance *i, const double *v, double *into);
void energy_add_jump(Instance *i, double *energies);
double energy_at_speed(Instance *i, double speed);
int coordinate_is_length(const Scene *s, int coordinate);
int coordinate_is_angle(const Scene *s, int coordinate);
double instance_largest(const Instance *i, const double *x);
double constraints_reach(const Instance *i, const double *q);
void constraints_limits(const Instance *i, const double *C, const double *q, const double *v, double *limits);
