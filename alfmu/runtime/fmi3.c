/* FMI 3.0 for co-simulation: scalar variables, no event mode, no clocks. */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "component.h"

/* The headers of FMI export what they declare. */
#include "fmi3Functions.h"

/* What FMI hands over beside the component. */
typedef struct {
    fmi3LogMessageCallback log;
    fmi3IntermediateUpdateCallback update;
    fmi3InstanceEnvironment environment;
    int may_return;
} Host;

static void logged(void *host, const char *name, Category category, const char *text)
{
    static const fmi3Status statuses[CATEGORIES] = {fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal};
    const Host *h = host;
    (void)name;
    h->log(h->environment, statuses[category], category_names[category], text);
}

/* A call for which there is nothing in this FMU. */
static fmi3Status unknown(fmi3Instance instance, const char *call)
{
    Component *c = instance;
    if (component_good(c))
        component_refuse(c, ERROR_, call, "this FMU has nothing of the kind");
    return fmi3Error;
}

/* The same, where nothing is asked for, which is no error. */
static fmi3Status none(fmi3Instance instance, size_t count, const char *call)
{
    Component *c = instance;
    return component_good(c) && !count ? fmi3OK : unknown(instance, call);
}

/* Life ------------------------------------------------------------------------------------------------------------- */

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean may_return, const fmi3ValueReference intermediate[],
    size_t intermediate_count, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback update)
{
    char why[400] = "there is no memory for it", text[500];
    Component *c = component_new(name, token, resources, why, sizeof why);
    Host *host = c ? calloc(1, sizeof *host) : NULL;
    (void)visible;
    (void)event_mode;
    (void)intermediate;
    (void)intermediate_count;
    if (!host) {
        if (c)
            component_free(c);
        snprintf(text, sizeof text, "cannot be instantiated: %s", why);
        if (log)
            log(environment, fmi3Error, "logStatusError", text);
        return NULL;
    }
    host->log = log;
    host->update = update;
    host->environment = environment;
    host->may_return = may_return;
    c->host = host;
    c->log = log ? logged : NULL;
    component_logging(c, logging, 0, NULL);
    return c;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    (void)name;
    (void)token;
    (void)resources;
    (void)visible;
    (void)logging;
    if (log)
        log(environment, fmi3Error, "logStatusError", "this FMU is for co-simulation");
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
    fmi3Boolean visible, fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3ClockUpdateCallback clock, fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock)
{
    (void)clock;
    (void)lock;
    (void)unlock;
    return fmi3InstantiateModelExchange(name, token, resources, visible, logging, environment, log);
}

void fmi3FreeInstance(fmi3Instance instance)
{
    Component *c = instance;
    if (component_good(c)) {
        free(c->host);
        component_free(c);
    }
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t count, const fmi3String categories[])
{
    Component *c = instance;
    return component_in(c, ANY, "fmi3SetDebugLogging") && component_logging(c, on, count, categories) ? fmi3OK
                                                                                                      : fmi3Error;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean has_tolerance, fmi3Float64 tolerance,
    fmi3Float64 start, fmi3Boolean has_stop, fmi3Float64 stop)
{
    Component *c = instance;
    const Status status = component_begin(c, start, has_tolerance ? tolerance : 0.0, "fmi3EnterInitializationMode");
    (void)has_stop;
    (void)stop;
    if (status == FINE)
        c->phase = INITIALIZING;
    return (fmi3Status)status;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    return (fmi3Status)component_initialized(instance, "fmi3ExitInitializationMode");
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    return (fmi3Status)component_terminated(instance, "fmi3Terminate");
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    return (fmi3Status)component_reset(instance, "fmi3Reset");
}

/* Values ----------------------------------------------------------------------------------------------------------- */

/* The independent variable comes after all others. */
static int is_time(const Component *c, fmi3ValueReference reference)
{
    return reference == (fmi3ValueReference)variable_count(c->instance->scene);
}

static int as_many(Component *c, size_t count, size_t values, const char *call)
{
    if (!component_good(c))
        return 0;
    if (count == values)
        return 1;
    component_refuse(c, ERROR_, call, "every variable is a scalar: as many values as references");
    return 0;
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
    fmi3Float64 values[], size_t value_count)
{
    static const char call[] = "fmi3GetFloat64";
    Component *c = instance;
    Status status = FINE;
    int times = 0;
    if (!as_many(c, count, value_count, call))
        return fmi3Error;
    for (size_t k = 0; references && values && k < count; k++)
        times += is_time(c, references[k]);
    if (!times)
        status = component_readable(c, references, count, values, REAL, call);
    for (size_t k = 0; status <= WARNED && k < count; k++) {
        if (times && is_time(c, references[k])) {
            if (!component_in(c, KNOWN, call))
                return fmi3Error;
            values[k] = *instance_time(c->instance);
            continue;
        }
        if (times) {
            const Status one = component_readable(c, references + k, 1, values + k, REAL, call);
            status = one > status ? one : status;
        }
        if (status <= WARNED)
            values[k] = instance_get(c->instance, (int)references[k]);
    }
    return (fmi3Status)status;
}

fmi3Status fmi3GetInt32(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
    fmi3Int32 values[], size_t value_count)
{
    Component *c = instance;
    Status status;
    if (!as_many(c, count, value_count, "fmi3GetInt32"))
        return fmi3Error;
    status = component_readable(c, references, count, values, INTEGER, "fmi3GetInt32");
    for (size_t k = 0; status <= WARNED && k < count; k++) {
        const double value = instance_get(c->instance, (int)references[k]);
        values[k] = isfinite(value) ? (fmi3Int32)value : 0;
    }
    return (fmi3Status)status;
}

fmi3Status fmi3GetBoolean(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
    fmi3Boolean values[], size_t value_count)
{
    Component *c = instance;
    Status status;
    if (!as_many(c, count, value_count, "fmi3GetBoolean"))
        return fmi3Error;
    status = component_readable(c, references, count, values, BOOLEAN, "fmi3GetBoolean");
    for (size_t k = 0; status <= WARNED && k < count; k++)
        values[k] = instance_get(c->instance, (int)references[k]) != 0.0;
    return (fmi3Status)status;
}

fmi3Status fmi3GetString(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
    fmi3String values[], size_t value_count)
{
    Component *c = instance;
    Status status;
    if (!as_many(c, count, value_count, "fmi3GetString"))
        return fmi3Error;
    status = component_readable(c, references, count, values, STRING, "fmi3GetString");
    for (size_t k = 0; status <= WARNED && k < count; k++)
        values[k] = instance_chosen(c->instance, (int)references[k]);
    return (fmi3Status)status;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
    const fmi3Float64 values[], size_t value_count)
{
    Component *c = instance;
    Status status;
    if (!as_many(c, count, value_count, "fmi3SetFloat64"))
        return fmi3Error;
    status = component_writable(c, references, count, values, REAL, "fmi3SetFloat64");
    for (size_t k = 0; status != WRONG && k < count; k++)
        status = component_set(c, status, instance_set(c->instance, (int)references[k], values[k]));
    return (fmi3Status)status;
}

fmi3Status fmi3SetInt32(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
    const fmi3Int32 values[], size_t value_count)
{
    Component *c = instance;
    Status status;
    if (!as_many(c, count, value_count, "fmi3SetInt32"))
        return fmi3Error;
    status = component_writable(c, references, count, values, INTEGER, "fmi3SetInt32");
    for (size_t k = 0; status != WRONG && k < count; k++)
        status = component_set(c, status, instance_set(c->instance, (int)references[k], values[k]));
    return (fmi3Status)status;
}

fmi3Status fmi3SetBoolean(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
    const fmi3Boolean values[], size_t value_count)
{
    Component *c = instance;
    Status status;
    if (!as_many(c, count, value_count, "fmi3SetBoolean"))
        return fmi3Error;
    status = component_writable(c, references, count, values, BOOLEAN, "fmi3SetBoolean");
    for (size_t k = 0; status != WRONG && k < count; k++)
        status = component_set(c, status, instance_set(c->instance, (int)references[k], values[k]));
    return (fmi3Status)status;
}

fmi3Status fmi3SetString(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
    const fmi3String values[], size_t value_count)
{
    Component *c = instance;
    Status status;
    if (!as_many(c, count, value_count, "fmi3SetString"))
        return fmi3Error;
    status = component_writable(c, references, count, values, STRING, "fmi3SetString");
    for (size_t k = 0; status != WRONG && k < count; k++)
        status = component_set(c, status, instance_choose(c->instance, (int)references[k], values[k]));
    return (fmi3Status)status;
}

/* Types that no variable has. */
#define NO_VARIABLES(TYPE) \
    fmi3Status fmi3Get##TYPE(fmi3Instance instance, const fmi3ValueReference references[], size_t count, \
        fmi3##TYPE values[], size_t value_count) \
    { \
        (void)references; \
        (void)values; \
        return none(instance, count + value_count, "fmi3Get" #TYPE); \
    } \
    fmi3Status fmi3Set##TYPE(fmi3Instance instance, const fmi3ValueReference references[], size_t count, \
        const fmi3##TYPE values[], size_t value_count) \
    { \
        (void)references; \
        (void)values; \
        return none(instance, count + value_count, "fmi3Set" #TYPE); \
    }

NO_VARIABLES(Float32)
NO_VARIABLES(Int8)
NO_VARIABLES(UInt8)
NO_VARIABLES(Int16)
NO_VARIABLES(UInt16)
NO_VARIABLES(UInt32)
NO_VARIABLES(Int64)
NO_VARIABLES(UInt64)

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference references[], size_t count, size_t sizes[],
    fmi3Binary values[], size_t value_count)
{
    (void)references;
    (void)sizes;
    (void)values;
    return none(instance, count + value_count, "fmi3GetBinary");
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
    const size_t sizes[], const fmi3Binary values[], size_t value_count)
{
    (void)references;
    (void)sizes;
    (void)values;
    return none(instance, count + value_count, "fmi3SetBinary");
}

/* Steps and derivatives -------------------------------------------------------------------------------------------- */

/* A communication step made of internal ones, between which the host may look, and may end it. */
static Status watched(Component *c, double point, double step, fmi3Boolean *early)
{
    Instance *i = c->instance;
    const Host *host = c->host;
    const double count = fmax(1.0, ceil(step / i->values[i->scene->step_size] * (1 - 1e-12)));
    if (!(isfinite(step) && step > 0.0 && count < 1e9))
        return component_step(c, point, step);
    for (double k = 0.0; k < count; k += 1.0) {
        fmi3Boolean wanted = fmi3False;
        fmi3Float64 until = 0.0;
        Status status;
        i->within = k > 0.0;
        status = component_step(c, k > 0.0 ? *instance_time(i) : point, step / count);
        i->within = 0;
        if (status != FINE) {
            /* What was reached is good, and the next step says what is wrong. */
            *early = k > 0.0;
            return k > 0.0 ? FINE : status;
        }
        if (host->update && k + 1.0 < count)
            host->update(host->environment, *instance_time(i), fmi3False, fmi3True, fmi3True, fmi3True, &wanted,
                &until);
        if (wanted) {
            *early = fmi3True;
            return FINE;
        }
    }
    *instance_time(i) = point + step;
    return FINE;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 point, fmi3Float64 step, fmi3Boolean no_way_back,
    fmi3Boolean *events, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *reached)
{
    Component *c = instance;
    fmi3Boolean returned = fmi3False;
    Status status;
    (void)no_way_back;
    if (!component_in(c, STEPPING, "fmi3DoStep"))
        return fmi3Error;
    status = ((Host *)c->host)->may_return ? watched(c, point, step, &returned) : component_step(c, point, step);
    if (events)
        *events = fmi3False;
    if (terminate)
        *terminate = fmi3False;
    if (early)
        *early = returned;
    if (reached)
        *reached = *instance_time(c->instance);
    return (fmi3Status)status;
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
    size_t unknown_count, const fmi3ValueReference knowns[], size_t known_count, const fmi3Float64 seed[],
    size_t seed_count, fmi3Float64 sensitivity[], size_t sensitivity_count)
{
    static const char call[] = "fmi3GetDirectionalDerivative";
    if (!as_many(instance, unknown_count, sensitivity_count, call) || !as_many(instance, known_count, seed_count, call))
        return fmi3Error;
    return (fmi3Status)component_derivative(
        instance, unknowns, unknown_count, knowns, known_count, seed, sensitivity, call);
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t unknown_count,
    const fmi3ValueReference knowns[], size_t known_count, const fmi3Float64 seed[], size_t seed_count,
    fmi3Float64 sensitivity[], size_t sensitivity_count)
{
    (void)unknowns;
    (void)knowns;
    (void)seed;
    (void)sensitivity;
    return none(
        instance, unknown_count + known_count + seed_count + sensitivity_count, "fmi3GetAdjointDerivative");
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
    const fmi3Int32 orders[], fmi3Float64 values[], size_t value_count)
{
    (void)references;
    (void)orders;
    (void)values;
    return none(instance, count + value_count, "fmi3GetOutputDerivatives");
}

/* State ------------------------------------------------------------------------------------------------------------ */

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    Component *c = instance;
    State *made;
    if (!component_in(c, ANY, "fmi3GetFMUState") || !state)
        return fmi3Error;
    made = state_of(c, *state, "fmi3GetFMUState");
    if (!made)
        return fmi3Error;
    *state = made;
    return fmi3OK;
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state)
{
    Component *c = instance;
    return state_known(c, state, "fmi3SetFMUState") && state_apply(c, state) ? fmi3OK : fmi3Error;
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    Component *c = instance;
    if (!component_in(c, ANY, "fmi3FreeFMUState") || !state)
        return fmi3Error;
    if (!*state)
        return fmi3OK;
    if (!state_known(c, *state, "fmi3FreeFMUState"))
        return fmi3Error;
    free(*state);
    *state = NULL;
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *size)
{
    if (!state_known(instance, state, "fmi3SerializedFMUStateSize") || !size)
        return fmi3Error;
    *size = serialized_size(state);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    if (!state_known(instance, state, "fmi3SerializeFMUState") || !bytes || size < serialized_size(state))
        return fmi3Error;
    serialize(state, bytes);
    return fmi3OK;
}

fmi3Status fmi3DeserializeFMUState(
    fmi3Instance instance, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    Component *c = instance;
    State *made;
    if (!component_in(c, ANY, "fmi3DeserializeFMUState") || !bytes || !state)
        return fmi3Error;
    made = deserialized(c, bytes, size);
    if (!made)
        return fmi3Error;
    *state = made;
    return fmi3OK;
}

/* What belongs to other kinds of FMUs ------------------------------------------------------------------------------ */

fmi3Status fmi3EnterEventMode(fmi3Instance instance)
{
    return unknown(instance, "fmi3EnterEventMode");
}

fmi3Status fmi3EnterStepMode(fmi3Instance instance)
{
    return unknown(instance, "fmi3EnterStepMode");
}

fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance)
{
    return unknown(instance, "fmi3EnterConfigurationMode");
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance)
{
    return unknown(instance, "fmi3ExitConfigurationMode");
}

fmi3Status fmi3GetNumberOfVariableDependencies(
    fmi3Instance instance, fmi3ValueReference reference, size_t *count)
{
    (void)reference;
    (void)count;
    return unknown(instance, "fmi3GetNumberOfVariableDependencies");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance instance, fmi3ValueReference dependent, size_t elements[],
    fmi3ValueReference independents[], size_t independent_elements[], fmi3DependencyKind kinds[], size_t count)
{
    (void)dependent;
    (void)elements;
    (void)independents;
    (void)independent_elements;
    (void)kinds;
    (void)count;
    return unknown(instance, "fmi3GetVariableDependencies");
}

fmi3Status fmi3GetClock(
    fmi3Instance instance, const fmi3ValueReference references[], size_t count, fmi3Clock values[])
{
    (void)references;
    (void)values;
    return none(instance, count, "fmi3GetClock");
}

fmi3Status fmi3SetClock(
    fmi3Instance instance, const fmi3ValueReference references[], size_t count, const fmi3Clock values[])
{
    (void)references;
    (void)values;
    return none(instance, count, "fmi3SetClock");
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
    fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
{
    (void)references;
    (void)intervals;
    (void)qualifiers;
    return none(instance, count, "fmi3GetIntervalDecimal");
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
    fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
{
    (void)references;
    (void)counters;
    (void)resolutions;
    (void)qualifiers;
    return none(instance, count, "fmi3GetIntervalFraction");
}

fmi3Status fmi3GetShiftDecimal(
    fmi3Instance instance, const fmi3ValueReference references[], size_t count, fmi3Float64 shifts[])
{
    (void)references;
    (void)shifts;
    return none(instance, count, "fmi3GetShiftDecimal");
}

fmi3Status fmi3GetShiftFraction(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
    fmi3UInt64 counters[], fmi3UInt64 resolutions[])
{
    (void)references;
    (void)counters;
    (void)resolutions;
    return none(instance, count, "fmi3GetShiftFraction");
}

fmi3Status fmi3SetIntervalDecimal(
    fmi3Instance instance, const fmi3ValueReference references[], size_t count, const fmi3Float64 intervals[])
{
    (void)references;
    (void)intervals;
    return none(instance, count, "fmi3SetIntervalDecimal");
}

fmi3Status fmi3SetIntervalFraction(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
    const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
{
    (void)references;
    (void)counters;
    (void)resolutions;
    return none(instance, count, "fmi3SetIntervalFraction");
}

fmi3Status fmi3SetShiftDecimal(
    fmi3Instance instance, const fmi3ValueReference references[], size_t count, const fmi3Float64 shifts[])
{
    (void)references;
    (void)shifts;
    return none(instance, count, "fmi3SetShiftDecimal");
}

fmi3Status fmi3SetShiftFraction(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
    const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
{
    (void)references;
    (void)counters;
    (void)resolutions;
    return none(instance, count, "fmi3SetShiftFraction");
}

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance)
{
    return unknown(instance, "fmi3EvaluateDiscreteStates");
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *again, fmi3Boolean *terminate,
    fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *has_next, fmi3Float64 *next)
{
    (void)again;
    (void)terminate;
    (void)nominals;
    (void)values;
    (void)has_next;
    (void)next;
    return unknown(instance, "fmi3UpdateDiscreteStates");
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance)
{
    return unknown(instance, "fmi3EnterContinuousTimeMode");
}

fmi3Status fmi3CompletedIntegratorStep(
    fmi3Instance instance, fmi3Boolean no_way_back, fmi3Boolean *enter, fmi3Boolean *terminate)
{
    (void)no_way_back;
    (void)enter;
    (void)terminate;
    return unknown(instance, "fmi3CompletedIntegratorStep");
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time)
{
    (void)time;
    return unknown(instance, "fmi3SetTime");
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 states[], size_t count)
{
    (void)states;
    (void)count;
    return unknown(instance, "fmi3SetContinuousStates");
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[], size_t count)
{
    (void)derivatives;
    (void)count;
    return unknown(instance, "fmi3GetContinuousStateDerivatives");
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 indicators[], size_t count)
{
    (void)indicators;
    (void)count;
    return unknown(instance, "fmi3GetEventIndicators");
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 states[], size_t count)
{
    (void)states;
    (void)count;
    return unknown(instance, "fmi3GetContinuousStates");
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[], size_t count)
{
    (void)nominals;
    (void)count;
    return unknown(instance, "fmi3GetNominalsOfContinuousStates");
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *count)
{
    (void)count;
    return unknown(instance, "fmi3GetNumberOfEventIndicators");
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *count)
{
    (void)count;
    return unknown(instance, "fmi3GetNumberOfContinuousStates");
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance instance, fmi3ValueReference clock, fmi3Float64 time)
{
    (void)clock;
    (void)time;
    return unknown(instance, "fmi3ActivateModelPartition");
}
