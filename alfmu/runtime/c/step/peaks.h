/* Largest magnitudes of outputs within a communication step. */

#pragma once

#include "instance.h"
#include "scene.h"

#ifndef WITHOUT_PEAKS
size_t peaks_room(const Scene *s);
void peaks_broken(Instance *i);
void peaks_begin(Instance *i);
void peaks_along(Instance *i, const double *begin);
#else
static inline size_t peaks_room(const Scene *s) { return (void)s, 0; }
static inline void peaks_broken(Instance *i) { (void)i; }
static inline void peaks_begin(Instance *i) { (void)i; }
static inline void peaks_along(Instance *i, const double *begin) { (void)i, (void)begin; }
#endif
