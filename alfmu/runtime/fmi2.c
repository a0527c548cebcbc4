/* FMI 2.0 for co-simulation. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "component.h"

/* The headers of FMI export what they declare. */
#include "fmi2Functions.h"

/* What FMI hands over beside the component. */
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

/* Life ------------------------------------------------------------------------------------------------------------- */

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
    const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    char why[400] = "it is for co-simulation", text[500];
    Component *c = type == fmi2CoSimulation ? component_new(name, guid, resources, why, sizeof why) : NULL;
    Host *host;
    (void)visible;
    if (!c) {
        snprintf(text, sizeof text, "cannot be instantiated: %s", why);
        if (functions && functions->logger)
            functions->logger(functions->componentEnvironment, name ? name : "", fmi2Error, "logStatusError", text);
        return NULL;
    }
    host = calloc(1, sizeof *host);
    if (!host) {
        component_free(c);
        return NULL;
    }
    if (functions && functions->logger) {
        host->logger = functions->logger;
        host->environment = functions->componentEnvironment;
        c->log = logged;
    }
    c->host = host;
    component_logging(c, logging, 0, NULL);
    return c;
}

void fmi2FreeInstance(fmi2Component component)
{
    Component *c = component;
    if (component_good(c)) {
        free(c->host);
        component_free(c);
    }
}

fmi2Status fmi2SetDebugLogging(
    fmi2Component component, fmi2Boolean on, size_t count, const fmi2String categories[])
{
    Component *c = component;
    return component_in(c, ANY, "fmi2SetDebugLogging") && component_logging(c, on, count, categories) ? fmi2OK
                                                                                                      : fmi2Error;
}

fmi2Status fmi2SetupExperiment(fmi2Component component, fmi2Boolean has_tolerance, fmi2Real tolerance,
    fmi2Real start, fmi2Boolean has_stop, fmi2Real stop)
{
    Component *c = component;
    (void)has_stop;
    (void)stop;
    return (fmi2Status)component_begin(c, start, has_tolerance ? tolerance : 0.0, "fmi2SetupExperiment");
}

fmi2Status fmi2EnterInitializationMode(fmi2Component component)
{
    Component *c = component;
    if (!component_in(c, INSTANTIATED, "fmi2EnterInitializationMode"))
        return fmi2Error;
    c->phase = INITIALIZING;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component component)
{
    return (fmi2Status)component_initialized(component, "fmi2ExitInitializationMode");
}

fmi2Status fmi2Terminate(fmi2Component component)
{
    return (fmi2Status)component_terminated(component, "fmi2Terminate");
}

fmi2Status fmi2Reset(fmi2Component component)
{
    return (fmi2Status)component_reset(component, "fmi2Reset");
}

/* Values ----------------------------------------------------------------------------------------------------------- */

fmi2Status fmi2GetReal(
    fmi2Component component, const fmi2ValueReference references[], size_t count, fmi2Real values[])
{
    Component *c = component;
    const Status status = component_readable(c, references, count, values, REAL, "fmi2GetReal");
    for (size_t k = 0; status <= WARNED && k < count; k++)
        values[k] = instance_get(c->instance, (int)references[k]);
    return (fmi2Status)status;
}

fmi2Status fmi2GetInteger(
    fmi2Component component, const fmi2ValueReference references[], size_t count, fmi2Integer values[])
{
    Component *c = component;
    const Status status = component_readable(c, references, count, values, INTEGER, "fmi2GetInteger");
    for (size_t k = 0; status <= WARNED && k < count; k++) {
        const double value = instance_get(c->instance, (int)references[k]);
        values[k] = value - value == 0.0 ? (fmi2Integer)value : 0;
    }
    return (fmi2Status)status;
}

fmi2Status fmi2GetBoolean(
    fmi2Component component, const fmi2ValueReference references[], size_t count, fmi2Boolean values[])
{
    Component *c = component;
    const Status status = component_readable(c, references, count, values, BOOLEAN, "fmi2GetBoolean");
    for (size_t k = 0; status <= WARNED && k < count; k++)
        values[k] = instance_get(c->instance, (int)references[k]) != 0.0;
    return (fmi2Status)status;
}

fmi2Status fmi2GetString(
    fmi2Component component, const fmi2ValueReference references[], size_t count, fmi2String values[])
{
    Component *c = component;
    const Status status = component_readable(c, references, count, values, STRING, "fmi2GetString");
    for (size_t k = 0; status <= WARNED && k < count; k++)
        values[k] = instance_chosen(c->instance, (int)references[k]);
    return (fmi2Status)status;
}

fmi2Status fmi2SetReal(
    fmi2Component component, const fmi2ValueReference references[], size_t count, const fmi2Real values[])
{
    Component *c = component;
    Status status = component_writable(c, references, count, values, REAL, "fmi2SetReal");
    for (size_t k = 0; status != WRONG && k < count; k++)
        status = component_set(c, status, instance_set(c->instance, (int)references[k], values[k]));
    return (fmi2Status)status;
}

fmi2Status fmi2SetInteger(
    fmi2Component component, const fmi2ValueReference references[], size_t count, const fmi2Integer values[])
{
    Component *c = component;
    Status status = component_writable(c, references, count, values, INTEGER, "fmi2SetInteger");
    for (size_t k = 0; status != WRONG && k < count; k++)
        status = component_set(c, status, instance_set(c->instance, (int)references[k], values[k]));
    return (fmi2Status)status;
}

fmi2Status fmi2SetBoolean(
    fmi2Component component, const fmi2ValueReference references[], size_t count, const fmi2Boolean values[])
{
    Component *c = component;
    Status status = component_writable(c, references, count, values, BOOLEAN, "fmi2SetBoolean");
    for (size_t k = 0; status != WRONG && k < count; k++)
        status = component_set(c, status, instance_set(c->instance, (int)references[k], values[k] != fmi2False));
    return (fmi2Status)status;
}

fmi2Status fmi2SetString(
    fmi2Component component, const fmi2ValueReference references[], size_t count, const fmi2String values[])
{
    Component *c = component;
    Status status = component_writable(c, references, count, values, STRING, "fmi2SetString");
    for (size_t k = 0; status != WRONG && k < count; k++)
        status = component_set(c, status, instance_choose(c->instance, (int)references[k], values[k]));
    return (fmi2Status)status;
}

/* Derivatives ------------------------------------------------------------------------------------------------------ */

fmi2Status fmi2GetDirectionalDerivative(fmi2Component component, const fmi2ValueReference unknowns[],
    size_t unknown_count, const fmi2ValueReference knowns[], size_t known_count, const fmi2Real directions[],
    fmi2Real changes[])
{
    return (fmi2Status)component_derivative(component, unknowns, unknown_count, knowns, known_count, directions,
        changes, "fmi2GetDirectionalDerivative");
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component component, const fmi2ValueReference references[], size_t count,
    const fmi2Integer orders[], const fmi2Real values[])
{
    static const char call[] = "fmi2SetRealInputDerivatives";
    Component *c = component;
    Status status = component_writable(c, references, count, values, REAL, call);
    if (status != FINE)
        return (fmi2Status)status;
    for (size_t k = 0; k < count; k++)
        if (!orders || orders[k] != 1 || c->instance->scene->variables[references[k]].kind != INPUT) {
            component_refuse(c, ERROR_, call, "there are first derivatives of inputs alone");
            return fmi2Error;
        }
    for (size_t k = 0; k < count; k++)
        status = component_set(c, status, instance_set_slope(c->instance, (int)references[k], values[k]));
    return (fmi2Status)status;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component component, const fmi2ValueReference references[], size_t count,
    const fmi2Integer orders[], fmi2Real values[])
{
    Component *c = component;
    (void)references;
    (void)orders;
    (void)values;
    if (!component_in(c, KNOWN, "fmi2GetRealOutputDerivatives"))
        return fmi2Error;
    if (!count)
        return fmi2OK;
    component_refuse(c, ERROR_, "fmi2GetRealOutputDerivatives", "there are none (maxOutputDerivativeOrder is 0)");
    return fmi2Error;
}

/* Steps ------------------------------------------------------------------------------------------------------------ */

fmi2Status fmi2DoStep(fmi2Component component, fmi2Real point, fmi2Real step, fmi2Boolean no_way_back)
{
    Component *c = component;
    (void)no_way_back;
    if (!component_in(c, STEPPING, "fmi2DoStep"))
        return fmi2Error;
    return (fmi2Status)component_step(c, point, step);
}

fmi2Status fmi2CancelStep(fmi2Component component)
{
    Component *c = component;
    if (component_good(c))
        component_refuse(c, ERROR_, "fmi2CancelStep", "no step is ever pending");
    return fmi2Error;
}

static fmi2Status no_status(Component *c, const char *call)
{
    if (component_in(c, STEPPING | TERMINATED, call))
        component_refuse(c, DISCARD, call, "no step is ever pending");
    return component_good(c) ? fmi2Discard : fmi2Error;
}

fmi2Status fmi2GetStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)kind;
    (void)value;
    return no_status(component, "fmi2GetStatus");
}

fmi2Status fmi2GetRealStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Real *value)
{
    Component *c = component;
    if (!component_in(c, STEPPING | TERMINATED, "fmi2GetRealStatus"))
        return fmi2Error;
    if (kind != fmi2LastSuccessfulTime || !value)
        return no_status(c, "fmi2GetRealStatus");
    *value = *instance_time(c->instance);
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)kind;
    (void)value;
    return no_status(component, "fmi2GetIntegerStatus");
}

fmi2Status fmi2GetBooleanStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Boolean *value)
{
    Component *c = component;
    if (!component_in(c, STEPPING | TERMINATED, "fmi2GetBooleanStatus"))
        return fmi2Error;
    if (kind != fmi2Terminated || !value)
        return no_status(c, "fmi2GetBooleanStatus");
    *value = fmi2False; /* A run never ends by itself. */
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component component, const fmi2StatusKind kind, fmi2String *value)
{
    (void)kind;
    (void)value;
    return no_status(component, "fmi2GetStringStatus");
}

/* State ------------------------------------------------------------------------------------------------------------ */

fmi2Status fmi2GetFMUstate(fmi2Component component, fmi2FMUstate *state)
{
    Component *c = component;
    State *made;
    if (!component_in(c, ANY, "fmi2GetFMUstate") || !state)
        return fmi2Error;
    made = state_of(c, *state, "fmi2GetFMUstate");
    if (!made)
        return fmi2Error;
    *state = made;
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate state)
{
    Component *c = component;
    return state_known(c, state, "fmi2SetFMUstate") && state_apply(c, state) ? fmi2OK : fmi2Error;
}

fmi2Status fmi2FreeFMUstate(fmi2Component component, fmi2FMUstate *state)
{
    Component *c = component;
    if (!component_in(c, ANY, "fmi2FreeFMUstate") || !state)
        return fmi2Error;
    if (!*state)
        return fmi2OK;
    if (!state_known(c, *state, "fmi2FreeFMUstate"))
        return fmi2Error;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component component, fmi2FMUstate state, size_t *size)
{
    Component *c = component;
    if (!state_known(c, state, "fmi2SerializedFMUstateSize") || !size)
        return fmi2Error;
    *size = serialized_size(state);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component component, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    Component *c = component;
    if (!state_known(c, state, "fmi2SerializeFMUstate") || !bytes || size < serialized_size(state))
        return fmi2Error;
    serialize(state, (unsigned char *)bytes);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(
    fmi2Component component, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    Component *c = component;
    State *made;
    if (!component_in(c, ANY, "fmi2DeSerializeFMUstate") || !bytes || !state)
        return fmi2Error;
    made = deserialized(c, (const unsigned char *)bytes, size);
    if (!made)
        return fmi2Error;
    *state = made;
    return fmi2OK;
}
