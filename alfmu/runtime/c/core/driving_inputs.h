/* Driving inputs: the motions that they prescribe within a communication step. */

#pragma once

#include "instance.h"
#include "scene.h"

#ifndef WITHOUT_MOVING_INPUTS
/* The points of an input: their number, the order of their derivative, their times and values, newest first. */
enum { KNOWN_POINTS, LEVEL, TIMES, VALUES = TIMES + HEARD_POINTS };

/* The given value, rate and acceleration of an input, and the highest derivative that is given. */
typedef struct {
    double value[3];
    int level;
} Given;

enum { SAVED_LEVEL = HEARD, SAVED_START, SAVED_STEP, SAVED_FROM, SAVED_LITTLE, SAVED };

void inputs_begin(Instance *i, double time);
void input_aim(const Followed *f, const Given *g, double *c, double *heard, double start, double h, double little);
Outcome inputs_aim(Instance *i, double start, double h);
#else
static inline void inputs_begin(Instance *i, double time) { (void)i, (void)time; }
static inline Outcome inputs_aim(Instance *i, double start, double h) { return (void)i, (void)start, (void)h, DONE; }
#endif
