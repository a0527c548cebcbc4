/* The residue of an assembly, and Gauss-Newton steps that close its loops. */

#pragma once

#include "instance.h"
#include "least_squares.h"
#include "scene.h"

/* The equations that an assembly solves: the gaps of the rows in force, and the start values. */
typedef struct {
    const unsigned char *held;
    int count; /* gaps and start values */
    int untied; /* whether start values are guesses instead */
    Rows J;
    double *residue, *trial;
    double *rows, *columns; /* weights: 1 / length for gaps in metres; `units` times `readiness` for coordinates */
    double *units;          /* units of coordinates */
} Loops;

const double *loops_starts(const Instance *i);
void loops_evaluate(Instance *i, Loops *loops, const double *q);
Loops loops_new(Instance *i, const unsigned char *held, double length);
int loops_close(Instance *i, Loops *loops, const double *q);
double loops_follow(Instance *i, Loops *loops, double *q);
double coordinate_shortest_way(const Scene *s, int coordinate, double change);
double coordinates_apart(const Scene *s, const double *units, const double *from, const double *to);
void loops_beside_guess(
    const Instance *i, const Loops *loops, const double *guess, double size, int k, double *q);
const char *loops_gap_label(Instance *i, const Loops *loops, char *label, size_t size);
double loops_way(const Instance *i, const Loops *loops, const double *from, const double *to, int *most);
