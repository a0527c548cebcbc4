/* The functions that FMI 2 and FMI 3 share: for each X(name, arguments, function of this runtime, its arguments without
   the name of the call). STATE is the name of a state, and BYTE the type of a byte, in a version of FMI. */

#pragma once

#define SHARED_CALLS(X, STATE, BYTE) \
    X(ExitInitializationMode, (void *c), exchange_initialized, c) \
    X(Terminate, (void *c), component_terminated, c) \
    X(Reset, (void *c), component_reset, c) \
    X(Get##STATE, (void *c, void **state), component_save, c, state) \
    X(Set##STATE, (void *c, void *state), component_restore, c, state) \
    X(Free##STATE, (void *c, void **state), component_forget, c, state) \
    X(Serialized##STATE##Size, (void *c, void *state, size_t *size), component_state_size, c, state, size) \
    X(Serialize##STATE, (void *c, void *state, BYTE bytes[], size_t size), component_write, c, state, bytes, size) \
    X(EnterEventMode, (void *c), exchange_enter, c, AT_EVENT) \
    X(EnterContinuousTimeMode, (void *c), exchange_enter, c, CONTINUOUS) \
    X(SetTime, (void *c, double time), exchange_time, c, time) \
    X(SetContinuousStates, (void *c, const double states[], size_t count), exchange_set, c, states, count) \
    X(GetContinuousStates, (void *c, double x[], size_t count), exchange_get, c, STATES, x, count) \
    X(GetNominalsOfContinuousStates, (void *c, double x[], size_t count), exchange_get, c, NOMINALS, x, count) \
    X(GetEventIndicators, (void *c, double x[], size_t count), exchange_get, c, INDICATORS, x, count)
