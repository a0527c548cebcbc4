/* Dry friction that follows from the load: which joints stick and which slide. */

#pragma once

#include "instance.h"

#ifndef WITHOUT_FRICTION
double *friction_slip(const Instance *i, int k);
int friction_count_sticking(const Instance *i);
void friction_reset(Instance *i);
void friction_rates(Instance *i, double *rates);
const double *friction_gripped(Instance *i);
int friction_jammed(Instance *i);
Outcome friction_say_jam(Instance *i);
double friction_rest(const Instance *i);
Outcome friction_event(Instance *i, const unsigned char *stopped);
Outcome friction_checked(Instance *i);
Outcome friction_begin(Instance *i);
#else
static inline double *friction_slip(const Instance *i, int k) { return (void)k, i->discrete; }
static inline Outcome friction_event(Instance *i, const unsigned char *stopped) { return (void)i, (void)stopped, DONE; }
static inline Outcome friction_checked(Instance *i) { return (void)i, DONE; }
static inline void friction_reset(Instance *i) { (void)i; }
static inline int friction_jammed(Instance *i) { return (void)i, 0; }
static inline Outcome friction_say_jam(Instance *i) { return (void)i, DONE; }
static inline Outcome friction_begin(Instance *i) { return (void)i, DONE; }
#endif
