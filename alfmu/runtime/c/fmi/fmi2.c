/* FMI 2.0 for co-simulation and Model Exchange. */

#include <stdio.h>

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
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
} Host;

static void logged(void *host, const char *name, Category category, const char *text)
{
    static const fmi2Status statuses[CATEGORIES] = {fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal};
    const Host *h = host;
    h->logger(h->environment, name, statuses[category], category_names[category], text);
}

API const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

API const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

API fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
    const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    char why[500];
    const Border border = border_in();
    Component *c = component_new(name, guid, resources, sizeof(Host), why, sizeof why);
    Host *host;
    if (type == fmi2ModelExchange)
        c = exchange_instance(c, why, sizeof why);
    else if (c && type != fmi2CoSimulation) {
        snprintf(why, sizeof why, "%d is not a type of FMU", (int)type);
        component_free(c);
        c = NULL;
    }
    border_out(&border);
    (void)visible;
    if (!c) {
        char text[600] = "cannot be instantiated: ";
        strncat(text, why, sizeof text - strlen(text) - 1);
        if (functions && functions->logger)
            functions->logger(functions->componentEnvironment, name ? name : "", fmi2Error, "logStatusError", text);
        return NULL;
    }
    host = c->host;
    if (functions && functions->logger) {
        host->logger = functions->logger;
        host->environment = functions->componentEnvironment;
        c->log = logged;
    }
    component_logging(c, logging, 0, NULL, "fmi2Instantiate");
    return c;
}

API void fmi2FreeInstance(fmi2Component c)
{
    component_free(c);
}

API fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
    fmi2Boolean has_stop, fmi2Real stop)
{
    INSIDE(fmi2Status,
        component_begin(c, start, has_stop ? &stop : NULL, has_tolerance ? tolerance : 0.0, "fmi2SetupExperiment"));
}

/* A function that passes its arguments on. */
#define PASSED(NAME, ARGUMENTS, FUNCTION, ...) \
    API fmi2Status fmi2##NAME ARGUMENTS \
    { \
        INSIDE(fmi2Status, FUNCTION(__VA_ARGS__, "fmi2" #NAME)); \
    }

#define REFERENCES const fmi2ValueReference references[], size_t count

SHARED_CALLS(PASSED, FMUstate, fmi2Byte)
PASSED(EnterInitializationMode, (void *c), component_enter, c)
PASSED(SetDebugLogging, (void *c, fmi2Boolean on, size_t count, const fmi2String categories[]), component_logging, c,
    on, count, categories)
PASSED(SetRealInputDerivatives, (void *c, REFERENCES, const fmi2Integer orders[], const fmi2Real values[]),
    component_slopes, c, references, count, orders, values)
PASSED(GetRealOutputDerivatives, (void *c, REFERENCES, const fmi2Integer orders[], fmi2Real values[]),
    component_output_derivatives, c, references, count, orders, values, count)
PASSED(DeSerializeFMUstate, (void *c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state), component_read, c,
    bytes, size, state)
PASSED(GetDerivatives, (void *c, fmi2Real values[], size_t count), exchange_get, c, RATES, values, count)

#define VALUES(TYPE, FORM) \
    PASSED(Get##TYPE, (void *c, REFERENCES, fmi2##TYPE values[]), component_get, c, references, count, values, count, \
        FORM) \
    PASSED(Set##TYPE, (void *c, REFERENCES, const fmi2##TYPE values[]), component_set, c, references, count, values, \
        count, FORM)

VALUES(Real, AS_DOUBLE)
VALUES(Integer, AS_FMI2_INTEGER)
VALUES(Boolean, AS_INT_BOOLEAN)

/* Answer a call for variables that do not exist. */
static fmi2Status none(Component *c, int phases, size_t count, const char *call)
{
    if (!component_in(c, phases, call))
        return fmi2Error;
    return count ? (fmi2Status)component_refuse(c, ERROR_, call, "no variable is a string") : fmi2OK;
}

API fmi2Status fmi2GetString(
    fmi2Component c, const fmi2ValueReference references[], size_t count, fmi2String values[])
{
    (void)references;
    (void)values;
    return none(c, KNOWN, count, "fmi2GetString");
}

API fmi2Status fmi2SetString(
    fmi2Component c, const fmi2ValueReference references[], size_t count, const fmi2String values[])
{
    (void)references;
    (void)values;
    return none(c, BORN, count, "fmi2SetString");
}

API fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[], size_t unknown_count,
    const fmi2ValueReference knowns[], size_t known_count, const fmi2Real directions[], fmi2Real changes[])
{
    INSIDE(fmi2Status, component_derivative(c, unknowns, unknown_count, knowns, known_count, directions, known_count,
        changes, unknown_count, NULL, "fmi2GetDirectionalDerivative"));
}

API fmi2Status fmi2DoStep(fmi2Component c, fmi2Real point, fmi2Real step, fmi2Boolean no_way_back)
{
    (void)no_way_back;
    INSIDE(fmi2Status, component_step(c, point, step, NULL, "fmi2DoStep"));
}

API fmi2Status fmi2CancelStep(fmi2Component c)
{
    return component_in(c, ANY, "fmi2CancelStep")
        ? (fmi2Status)component_refuse(c, ERROR_, "fmi2CancelStep", "steps are never pending")
        : fmi2Error;
}

/* Return the outcome for a status kind; `found` is 0 for kinds that concern pending steps. */
static fmi2Status status_of(Component *c, int found, const char *call)
{
    if (!component_in(c, RUN, call))
        return fmi2Error;
    return found ? fmi2OK : (fmi2Status)component_refuse(c, DISCARD, call, "steps are never pending");
}

#define NEVER_PENDING(NAME, TYPE) \
    API fmi2Status fmi2##NAME(fmi2Component c, const fmi2StatusKind kind, TYPE *value) \
    { \
        (void)kind; \
        (void)value; \
        return status_of(c, 0, "fmi2" #NAME); \
    }

NEVER_PENDING(GetStatus, fmi2Status)
NEVER_PENDING(GetIntegerStatus, fmi2Integer)
NEVER_PENDING(GetStringStatus, fmi2String)

API fmi2Status fmi2GetRealStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Real *value)
{
    Component *c = component;
    const fmi2Status status = status_of(c, kind == fmi2LastSuccessfulTime && value, "fmi2GetRealStatus");
    if (status == fmi2OK)
        *value = *instance_time(c->instance);
    return status;
}

API fmi2Status fmi2GetBooleanStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Boolean *value)
{
    Component *c = component;
    const fmi2Status status = status_of(c, kind == fmi2Terminated && value, "fmi2GetBooleanStatus");
    if (status == fmi2OK)
        *value = c->refusals > 1; /* Hosts that only repeat a discarded step, as fmpy, would never end. */
    return status;
}

/* Model Exchange --------------------------------------------------------------------------------------------------- */

API fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    Exchange_event event = {0, 0.0};
    const Border border = border_in();
    const Status status = exchange_updated(c, &event, "fmi2NewDiscreteStates");
    border_out(&border);
    if (info)
        *info = (fmi2EventInfo){fmi2False, fmi2False, fmi2False, fmi2True, event.timed, event.next};
    return (fmi2Status)status;
}

API fmi2Status fmi2CompletedIntegratorStep(
    fmi2Component c, fmi2Boolean no_way_back, fmi2Boolean *enter, fmi2Boolean *terminate)
{
    (void)no_way_back;
    if (!enter || !terminate)
        return fmi2Error;
    *enter = *terminate = fmi2False;
    INSIDE(fmi2Status, exchange_accepted(c, enter, "fmi2CompletedIntegratorStep"));
}
