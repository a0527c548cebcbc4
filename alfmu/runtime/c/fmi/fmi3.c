/* FMI 3.0 for co-simulation, without event mode, and Model Exchange: scalar variables, no clocks. */

#include "adjoint.h"
#include "border.h"
#include "component.h"
#include "component_values.h"
#include "driving_inputs.h"
#include "fmi.h"
#include "instance.h"
#include "model_exchange.h"
#include "shared_calls.h"

/* FMI's arguments besides the component. */
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

static void look(void *host, double time, int can_return, double *until)
{
    const Host *h = host;
    fmi3Boolean wanted = fmi3False;
    fmi3Float64 from = time;
    h->update(h->environment, time, fmi3False, fmi3True, fmi3True, can_return != 0, &wanted, &from);
    if (wanted && can_return)
        *until = from;
}

/* Answer a call for features that this FMU does not have; the other arguments are ignored. */
static fmi3Status unknown(Component *c, const char *call, ...)
{
    return component_good(c) ? (fmi3Status)component_refuse(c, ERROR_, call, "this FMU does not support this function")
                             : fmi3Error;
}

/* Return OK if the count is zero. */
static fmi3Status none(Component *c, size_t count, const char *call, ...)
{
    return component_good(c) && !count ? fmi3OK : unknown(c, call);
}

API const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

static fmi3Instance not_made(fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, const char *why, ...)
{
    char text[600] = "cannot be instantiated: ";
    strncat(text, why, sizeof text - strlen(text) - 1);
    if (log)
        log(environment, fmi3Error, "logStatusError", text);
    return NULL;
}

/* Hand a new component over to its host. */
static Component *begun(Component *c, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback update, fmi3Boolean may_return, fmi3Boolean logging, const char *call)
{
    Host *host = c->host;
    host->log = log;
    host->update = update;
    host->environment = environment;
    host->may_return = may_return;
    c->log = log ? logged : NULL;
    c->look = update ? look : NULL;
    c->has_time = 1;
    component_logging(c, logging, 0, NULL, call);
    return c;
}

API fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
    fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean may_return,
    const fmi3ValueReference intermediate[], size_t intermediate_count, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    char why[500] = "it has no event mode (hasEventMode is false); leave eventModeUsed false";
    const Border border = border_in();
    Component *c = event_mode ? NULL : component_new(name, token, resources, sizeof(Host), why, sizeof why);
    border_out(&border);
    if (!c)
        return not_made(environment, log, why, visible, intermediate, intermediate_count);
    return begun(c, environment, log, update, may_return, logging, "fmi3InstantiateCoSimulation");
}

API fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
    fmi3Boolean visible, fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    char why[500];
    const Border border = border_in();
    Component *c = exchange_instance(
        component_new(name, token, resources, sizeof(Host), why, sizeof why), why, sizeof why);
    border_out(&border);
    return c ? begun(c, environment, log, NULL, fmi3False, logging, "fmi3InstantiateModelExchange")
             : not_made(environment, log, why, visible);
}

API fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
    fmi3Boolean visible, fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3ClockUpdateCallback clock, fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock)
{
    return not_made(environment, log, "it supports co-simulation only", name, token, resources, visible, logging, clock,
        lock, unlock);
}

API void fmi3FreeInstance(fmi3Instance c)
{
    component_free(c);
}

API fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean has_tolerance, fmi3Float64 tolerance,
    fmi3Float64 start, fmi3Boolean has_stop, fmi3Float64 stop)
{
    static const char call[] = "fmi3EnterInitializationMode";
    const Border border = border_in();
    const Status begun = component_begin(c, start, has_stop ? &stop : NULL, has_tolerance ? tolerance : 0.0, call);
    border_out(&border);
    if (begun <= STATUS_WARNING)
        component_enter(c, call);
    return (fmi3Status)begun;
}

/* A function that passes its arguments on. */
#define PASSED(NAME, ARGUMENTS, FUNCTION, ...) \
    API fmi3Status fmi3##NAME ARGUMENTS \
    { \
        INSIDE(fmi3Status, FUNCTION(__VA_ARGS__, "fmi3" #NAME)); \
    }

#define REFERENCES const fmi3ValueReference *references, size_t count

SHARED_CALLS(PASSED, FMUState, fmi3Byte)
PASSED(SetDebugLogging, (void *c, fmi3Boolean on, size_t count, const fmi3String categories[]), component_logging, c,
    on, count, categories)
PASSED(GetOutputDerivatives,
    (void *c, REFERENCES, const fmi3Int32 orders[], fmi3Float64 values[], size_t value_count),
    component_output_derivatives, c, references, count, orders, values, value_count)
PASSED(DeserializeFMUState, (void *c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state), component_read, c,
    bytes, size, state)
PASSED(GetContinuousStateDerivatives, (void *c, fmi3Float64 x[], size_t count), exchange_get, c, RATES, x, count)
PASSED(GetNumberOfContinuousStates, (void *c, size_t *count), exchange_count, c, STATES, count)
PASSED(GetNumberOfEventIndicators, (void *c, size_t *count), exchange_count, c, INDICATORS, count)

#define OF_TYPE(TYPE) (void *c, REFERENCES, TYPE values[], size_t value_count)
#define VALUES(TYPE, FORM) \
    PASSED(Get##TYPE, OF_TYPE(fmi3##TYPE), component_get, c, references, count, values, value_count, FORM) \
    PASSED(Set##TYPE, OF_TYPE(const fmi3##TYPE), component_set, c, references, count, values, value_count, FORM)

VALUES(Float64, AS_DOUBLE)
VALUES(Int32, AS_INT)
VALUES(Int64, AS_INT64) /* choices */
VALUES(Boolean, AS_BOOL)

#define NO_VARIABLE(NAME, ARGUMENTS, COUNT, ...) \
    API fmi3Status fmi3##NAME ARGUMENTS \
    { \
        return none(c, COUNT, "fmi3" #NAME, __VA_ARGS__); \
    }

/* Types that no variable has. */
#define NO_VALUES(TYPE) \
    NO_VARIABLE(Get##TYPE, OF_TYPE(fmi3##TYPE), count + value_count, references, values) \
    NO_VARIABLE(Set##TYPE, OF_TYPE(const fmi3##TYPE), count + value_count, references, values)

NO_VALUES(Float32)
NO_VALUES(Int8)
NO_VALUES(UInt8)
NO_VALUES(Int16)
NO_VALUES(UInt16)
NO_VALUES(UInt32)
NO_VALUES(UInt64)
NO_VALUES(String)

NO_VARIABLE(GetBinary, (void *c, REFERENCES, size_t sizes[], fmi3Binary values[], size_t value_count),
    count + value_count, references, sizes, values)
NO_VARIABLE(SetBinary, (void *c, REFERENCES, const size_t sizes[], const fmi3Binary values[], size_t value_count),
    count + value_count, references, sizes, values)
NO_VARIABLE(GetClock, (void *c, REFERENCES, fmi3Clock values[]), count, references, values)
NO_VARIABLE(SetClock, (void *c, REFERENCES, const fmi3Clock values[]), count, references, values)
NO_VARIABLE(GetIntervalDecimal, (void *c, REFERENCES, fmi3Float64 x[], fmi3IntervalQualifier qualifiers[]), count,
    references, x, qualifiers)
NO_VARIABLE(SetIntervalDecimal, (void *c, REFERENCES, const fmi3Float64 x[]), count, references, x)
NO_VARIABLE(GetIntervalFraction,
    (void *c, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[]), count,
    references, counters, resolutions, qualifiers)
NO_VARIABLE(SetIntervalFraction, (void *c, REFERENCES, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]),
    count, references, counters, resolutions)
NO_VARIABLE(GetShiftDecimal, (void *c, REFERENCES, fmi3Float64 x[]), count, references, x)
NO_VARIABLE(SetShiftDecimal, (void *c, REFERENCES, const fmi3Float64 x[]), count, references, x)
NO_VARIABLE(GetShiftFraction, (void *c, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[]), count, references,
    counters, resolutions)
NO_VARIABLE(SetShiftFraction, (void *c, REFERENCES, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]), count,
    references, counters, resolutions)

API fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 point, fmi3Float64 step, fmi3Boolean no_way_back,
    fmi3Boolean *events, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *reached)
{
    Component *c = instance;
    int returned = component_good(c) && ((Host *)c->host)->may_return;
    const Border border = border_in();
    const Status status = component_step(c, point, step, &returned, "fmi3DoStep");
    border_out(&border);
    (void)no_way_back;
    if (status == STATUS_ERROR)
        return fmi3Error;
    if (events)
        *events = fmi3False;
    if (terminate)
        *terminate = fmi3False;
    if (early)
        *early = returned != 0;
    if (reached)
        *reached = *instance_time(c->instance);
    return (fmi3Status)status;
}

API fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t unknown_count,
    const fmi3ValueReference knowns[], size_t known_count, const fmi3Float64 seed[], size_t seed_count,
    fmi3Float64 sensitivity[], size_t sensitivity_count)
{
    INSIDE(fmi3Status, component_derivative(c, unknowns, unknown_count, knowns, known_count, seed, seed_count,
        sensitivity, sensitivity_count, NULL, "fmi3GetDirectionalDerivative"));
}

API fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t unknown_count,
    const fmi3ValueReference knowns[], size_t known_count, const fmi3Float64 seed[], size_t seed_count,
    fmi3Float64 sensitivity[], size_t sensitivity_count)
{
    INSIDE(fmi3Status, component_derivative(c, unknowns, unknown_count, knowns, known_count, seed, seed_count,
        sensitivity, sensitivity_count, adjoints_along, "fmi3GetAdjointDerivative"));
}

/* Functions without arguments. */
#define UNKNOWN(NAME) \
    API fmi3Status NAME(fmi3Instance c) \
    { \
        return unknown(c, #NAME); \
    }

UNKNOWN(fmi3EnterStepMode)
UNKNOWN(fmi3EnterConfigurationMode)
UNKNOWN(fmi3ExitConfigurationMode)
UNKNOWN(fmi3EvaluateDiscreteStates)

API fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference reference, size_t *count)
{
    return unknown(c, "fmi3GetNumberOfVariableDependencies", reference, count);
}

API fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference dependent, size_t elements[],
    fmi3ValueReference independents[], size_t independent_elements[], fmi3DependencyKind kinds[], size_t count)
{
    return unknown(c, "fmi3GetVariableDependencies", dependent, elements, independents, independent_elements, kinds,
        count);
}

API fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *terminate,
    fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *has_next, fmi3Float64 *next)
{
    Exchange_event event = {0, 0.0};
    const Border border = border_in();
    const Status status = exchange_updated(c, &event, "fmi3UpdateDiscreteStates");
    border_out(&border);
    if (!again || !terminate || !nominals || !values || !has_next || !next)
        return fmi3Error;
    *again = *terminate = *nominals = fmi3False;
    *values = fmi3True;
    *has_next = event.timed != 0;
    *next = event.next;
    return (fmi3Status)status;
}

API fmi3Status fmi3CompletedIntegratorStep(
    fmi3Instance c, fmi3Boolean no_way_back, fmi3Boolean *enter, fmi3Boolean *terminate)
{
    int far = 0;
    Border border;
    Status status;
    (void)no_way_back;
    if (!enter || !terminate)
        return fmi3Error;
    border = border_in();
    status = exchange_accepted(c, &far, "fmi3CompletedIntegratorStep");
    border_out(&border);
    *enter = far != 0;
    *terminate = fmi3False;
    return (fmi3Status)status;
}

API fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time)
{
    return unknown(c, "fmi3ActivateModelPartition", clock, time);
}
