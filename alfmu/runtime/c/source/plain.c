/* NAME.h: a mechanism as functions of plain C. */

#include "begin.h"
#include "instance.h"
#include "lifetime.h"
#include "outputs.h"
#include "run.h"
#include "scene.h"
#include "scene_sizes.h"
#include "variables.h"

/* Check that on this machine, too, the memory of NAME.h holds an instance and its numbers. */
typedef char NAME_fits[sizeof(Instance) + NUMBERS * sizeof(double) <= sizeof(NAME) ? 1 : -1];

static Instance *instance_of(NAME *m)
{
    return (Instance *)(void *)m->memory;
}

void NAME_init(NAME *m)
{
    memset(m, 0, sizeof *m);
    instance_lay(instance_of(m), &the_scene, m->memory + sizeof m->memory / sizeof *m->memory - NUMBERS, NULL,
        HAS_START);
}

int NAME_set(NAME *m, int variable, double value)
{
    const Variable *v = the_scene.variables + variable;
    if (variable < 0 || variable >= scene_variable_count(&the_scene)
        || ((v->kind == PARAMETER || v->kind == CHOICE) && (!HAS_START || instance_of(m)->flags.phase == STEPPING)))
        return REFUSED;
    return instance_set(instance_of(m), variable, value);
}

double NAME_get(NAME *m, int variable)
{
    if (variable < 0 || variable >= scene_variable_count(&the_scene))
        return NAN;
    if (variable >= scene_first_output(&the_scene)
        && (!instance_of(m)->flags.initialized || instance_read(instance_of(m)) != DONE))
        return NAN;
    return instance_get(instance_of(m), variable);
}

#ifndef WITHOUT_START
int NAME_start(NAME *m, double time)
{
    Instance *i = instance_of(m);
    Outcome outcome = i->flags.phase == INSTANTIATED ? instance_begin(i, time, INFINITY) : REFUSED;
    if (outcome == DONE)
        outcome = instance_initialize(i);
    if (outcome == DONE)
        outcome = instance_read(i);
    if (outcome == DONE)
        i->flags.phase = STEPPING;
    return outcome;
}
#else
/* This file contains the state after the start, found when it was generated. */
int NAME_start(NAME *m, double time)
{
    Instance *i = instance_of(m);
    double *u = i->m + the_scene.u, inputs[INPUTS];
    if (i->flags.phase != INSTANTIATED || !isfinite(time) || (the_scene.timed && time != 0.0))
        return REFUSED;
    memcpy(inputs, u, (size_t)the_scene.inputs * sizeof *u);
    memcpy(i->numbers, start_numbers, sizeof start_numbers);
    memcpy(u, inputs, (size_t)the_scene.inputs * sizeof *u);
    i->flags = start_flags;
    i->flags.phase = STEPPING;
    instance_set_time(i, time);
    return instance_read(i);
}
#endif

int NAME_step(NAME *m, double length)
{
    Instance *i = instance_of(m);
    return i->flags.phase == STEPPING ? instance_step(i, *instance_time(i), length) : REFUSED;
}

double NAME_time(NAME *m)
{
    return *instance_time(instance_of(m));
}
