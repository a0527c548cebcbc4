/* A host that treats a native FMU (FMI 2.0) badly: illegal orders, bad handles, references and values, many instances,
   threads. Linked with the runtime, compiled with MOST_STEPS; references HOST_REAL_INPUT, HOST_REAL_OUTPUT,
   HOST_PARAMETER, HOST_TEXT and HOST_SWITCH, the identity HOST_GUID, the mechanism HOST_SCENE and the URI HOST_RESOURCES
   of the folder with its scene are given when it is compiled. Says what went wrong, and returns how often. */

#include <math.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#define INSTANCES 1000 /* each reads its scene from the file; far more than files may be open */
#define TEXT(x) TEXT_OF(x)
#define TEXT_OF(x) #x
#define THREADS 4
#define STEPS 300

static int failures;

#define CHECK(condition) \
    do { \
        if (!(condition)) { \
            failures++; \
            printf("line %d: %s\n", __LINE__, #condition); \
        } \
    } while (0)

static char said[1000];

static void note(
    fmi2ComponentEnvironment host, fmi2String name, fmi2Status status, fmi2String category, fmi2String text, ...)
{
    (void)host;
    (void)name;
    (void)status;
    snprintf(said, sizeof said, "%s %s", category, text);
}

static void ignore(
    fmi2ComponentEnvironment host, fmi2String name, fmi2Status status, fmi2String category, fmi2String text, ...)
{
    (void)host;
    (void)name;
    (void)status;
    (void)category;
    (void)text;
}

static const fmi2CallbackFunctions talking = {note, calloc, free, NULL, NULL};
static const fmi2CallbackFunctions quiet = {ignore, calloc, free, NULL, NULL};

static fmi2Component made(void)
{
    return fmi2Instantiate("one", fmi2CoSimulation, HOST_GUID, HOST_RESOURCES, &talking, fmi2False, fmi2False);
}

static fmi2Status begun(fmi2Component c)
{
    fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0);
    fmi2EnterInitializationMode(c);
    return fmi2ExitInitializationMode(c);
}

static fmi2Component running(const fmi2CallbackFunctions *functions)
{
    fmi2Component c = fmi2Instantiate("one", fmi2CoSimulation, HOST_GUID, HOST_RESOURCES, functions, fmi2False, fmi2False);
    if (begun(c) != fmi2OK)
        failures++;
    return c;
}

static fmi2Status set(fmi2Component c, fmi2ValueReference reference, double value)
{
    return fmi2SetReal(c, &reference, 1, &value);
}

static double got(fmi2Component c, fmi2ValueReference reference)
{
    double value = NAN;
    return fmi2GetReal(c, &reference, 1, &value) == fmi2OK ? value : NAN;
}

static void instantiation(void)
{
    CHECK(!strcmp(fmi2GetVersion(), "2.0"));
    CHECK(!strcmp(fmi2GetTypesPlatform(), "default"));
    CHECK(!fmi2Instantiate("one", fmi2CoSimulation, "another", HOST_RESOURCES, &talking, fmi2False, fmi2False));
    CHECK(strstr(said, "differs from that of its scene"));
    CHECK(!fmi2Instantiate("one", (fmi2Type)2, HOST_GUID, HOST_RESOURCES, &talking, fmi2False, fmi2False));
    CHECK(strstr(said, "2 is not a type of FMU"));
    CHECK(!fmi2Instantiate(NULL, fmi2CoSimulation, HOST_GUID, HOST_RESOURCES, &talking, fmi2False, fmi2False));
    CHECK(strstr(said, "instance name is empty"));
    CHECK(!fmi2Instantiate("", fmi2CoSimulation, HOST_GUID, HOST_RESOURCES, &talking, fmi2False, fmi2False));
    CHECK(!fmi2Instantiate("one", fmi2CoSimulation, NULL, HOST_RESOURCES, &talking, fmi2False, fmi2False));
    CHECK(strstr(said, "the GUID, or instantiation token, is missing"));
    CHECK(!fmi2Instantiate("one", fmi2CoSimulation, NULL, "", NULL, fmi2False, fmi2False));
    {
        fmi2Component c = fmi2Instantiate("one", fmi2CoSimulation, HOST_GUID, HOST_RESOURCES, NULL, fmi2False, fmi2True);
        CHECK(c && fmi2DoStep(c, 0.0, 0.1, fmi2True) == fmi2Error); /* nobody to tell */
        fmi2FreeInstance(c);
    }
    for (int k = 0; k < 4; k++) { /* folders without a scene */
        static const char *const folders[] = {NULL, "", "file:///nowhere/at%20all", "%s%n%"};
        CHECK(!fmi2Instantiate("one", fmi2CoSimulation, HOST_GUID, folders[k], &talking, fmi2False, fmi2False));
        CHECK(strstr(said, "there is no scene.bin in its resources"));
    }
    fmi2FreeInstance(NULL);
}

/* Every call with a handle that is none. */
static void bad_handles(void)
{
    unsigned long other[20] = {0};
    fmi2Component handles[] = {NULL, other};
    for (int k = 0; k < 2; k++) {
        fmi2Component c = handles[k];
        fmi2ValueReference reference = 0;
        fmi2FMUstate state = NULL;
        size_t size;
        int whole;
        const char *text = "";
        fmi2Byte bytes[8] = {0};
        fmi2Status status;
        double value = 0.0;
        CHECK(fmi2SetDebugLogging(c, fmi2True, 0, NULL) == fmi2Error);
        CHECK(fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0) == fmi2Error);
        CHECK(fmi2EnterInitializationMode(c) == fmi2Error);
        CHECK(fmi2ExitInitializationMode(c) == fmi2Error);
        CHECK(fmi2Terminate(c) == fmi2Error);
        CHECK(fmi2Reset(c) == fmi2Error);
        CHECK(fmi2GetReal(c, &reference, 1, &value) == fmi2Error);
        CHECK(fmi2GetInteger(c, &reference, 1, &whole) == fmi2Error);
        CHECK(fmi2GetBoolean(c, &reference, 1, &whole) == fmi2Error);
        CHECK(fmi2GetString(c, &reference, 1, &text) == fmi2Error);
        CHECK(fmi2SetReal(c, &reference, 1, &value) == fmi2Error);
        CHECK(fmi2SetInteger(c, &reference, 1, &whole) == fmi2Error);
        CHECK(fmi2SetBoolean(c, &reference, 1, &whole) == fmi2Error);
        CHECK(fmi2SetString(c, &reference, 1, &text) == fmi2Error);
        CHECK(fmi2GetDirectionalDerivative(c, &reference, 1, &reference, 1, &value, &value) == fmi2Error);
        CHECK(fmi2SetRealInputDerivatives(c, &reference, 1, &whole, &value) == fmi2Error);
        CHECK(fmi2GetRealOutputDerivatives(c, &reference, 1, &whole, &value) == fmi2Error);
        CHECK(fmi2DoStep(c, 0.0, 0.1, fmi2True) == fmi2Error);
        CHECK(fmi2CancelStep(c) == fmi2Error);
        CHECK(fmi2GetStatus(c, fmi2DoStepStatus, &status) == fmi2Error);
        CHECK(fmi2GetRealStatus(c, fmi2LastSuccessfulTime, &value) == fmi2Error);
        CHECK(fmi2GetIntegerStatus(c, fmi2DoStepStatus, &whole) == fmi2Error);
        CHECK(fmi2GetBooleanStatus(c, fmi2Terminated, &whole) == fmi2Error);
        CHECK(fmi2GetStringStatus(c, fmi2PendingStatus, &text) == fmi2Error);
        CHECK(fmi2GetFMUstate(c, &state) == fmi2Error);
        CHECK(fmi2SetFMUstate(c, state) == fmi2Error);
        CHECK(fmi2SerializedFMUstateSize(c, state, &size) == fmi2Error);
        CHECK(fmi2SerializeFMUstate(c, state, bytes, sizeof bytes) == fmi2Error);
        CHECK(fmi2DeSerializeFMUstate(c, bytes, sizeof bytes, &state) == fmi2Error);
        CHECK(fmi2FreeFMUstate(c, &state) == fmi2Error);
        fmi2FreeInstance(c);
    }
}

static void illegal_orders(void)
{
    const fmi2ValueReference output = HOST_REAL_OUTPUT, input = HOST_REAL_INPUT;
    const int first = 1;
    double value = 0.0;
    fmi2Component c = made();
    CHECK(fmi2DoStep(c, 0.0, 0.1, fmi2True) == fmi2Error);
    CHECK(fmi2ExitInitializationMode(c) == fmi2Error);
    CHECK(strstr(said, "logStatusError") && strstr(said, HOST_SCENE) && strstr(said, "not before initialisation"));
    CHECK(fmi2Terminate(c) == fmi2Error);
    CHECK(fmi2GetReal(c, &output, 1, &value) == fmi2Error);
    CHECK(fmi2GetDirectionalDerivative(c, &output, 1, &input, 1, &value, &value) == fmi2Error);
    CHECK(fmi2SetupExperiment(c, fmi2False, 0.0, NAN, fmi2False, 0.0) == fmi2Error);
    CHECK(fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0) == fmi2OK);
    CHECK(fmi2EnterInitializationMode(c) == fmi2OK);
    CHECK(fmi2EnterInitializationMode(c) == fmi2Error);
    CHECK(fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0) == fmi2Error);
    CHECK(fmi2DoStep(c, 0.0, 0.1, fmi2True) == fmi2Error);
    CHECK(isfinite(got(c, HOST_REAL_OUTPUT)));
    CHECK(fmi2ExitInitializationMode(c) == fmi2OK);
    CHECK(fmi2ExitInitializationMode(c) == fmi2Error);
    CHECK(fmi2DoStep(c, 0.0, 0.1, fmi2True) == fmi2OK);
    CHECK(fmi2CancelStep(c) == fmi2Error);
    CHECK(fmi2GetRealOutputDerivatives(c, &output, 1, &first, &value) == fmi2OK && isfinite(value));
    CHECK(fmi2GetRealOutputDerivatives(c, NULL, 0, NULL, NULL) == fmi2OK);
    CHECK(fmi2GetRealOutputDerivatives(c, &output, 1, NULL, &value) == fmi2Error);
    CHECK(fmi2GetRealOutputDerivatives(c, &input, 1, &first, &value) == fmi2Error);
    for (int order = -1; order <= 3; order += 4)
        CHECK(fmi2GetRealOutputDerivatives(c, &output, 1, &order, &value) == fmi2Error);
    CHECK(fmi2Terminate(c) == fmi2OK);
    CHECK(fmi2Terminate(c) == fmi2Error);
    CHECK(fmi2DoStep(c, 0.1, 0.1, fmi2True) == fmi2Error);
    CHECK(set(c, HOST_REAL_INPUT, 1.0) == fmi2Error);
    CHECK(isfinite(got(c, HOST_REAL_OUTPUT)));
    CHECK(fmi2Reset(c) == fmi2OK);
    CHECK(fmi2DoStep(c, 0.0, 0.1, fmi2True) == fmi2Error);
    fmi2FreeInstance(c);
}

static void bad_values(void)
{
    const fmi2ValueReference far_off = 1000000, output = HOST_REAL_OUTPUT, text = HOST_TEXT, toggle = HOST_SWITCH;
    const char *unknown = "%s%n";
    const int second = 2, on = 2, none = 99;
    int whole;
    double value = 1.0, before;
    fmi2FMUstate state = NULL;
    fmi2Component c = made();
    fmi2EnterInitializationMode(c);
    before = got(c, HOST_PARAMETER);
    CHECK(set(c, HOST_PARAMETER, -1.0) == fmi2Discard);
    CHECK(strstr(said, "logStatusDiscard") && strstr(said, "is outside"));
    CHECK(fmi2SetString(c, &text, 1, &unknown) == fmi2Error);
    CHECK(fmi2SetInteger(c, &text, 1, &none) == fmi2Discard);
    CHECK(strstr(said, "supports 1 (continue), 2 (paper)"));
    CHECK(fmi2SetInteger(c, &text, 1, &second) == fmi2OK);
    CHECK(fmi2GetInteger(c, &text, 1, &whole) == fmi2OK && whole == second);
    CHECK(got(c, HOST_PARAMETER) == before); /* What was refused left the value before it in force. */
    CHECK(fmi2ExitInitializationMode(c) == fmi2OK);
    CHECK(set(c, HOST_PARAMETER, 1.0) == fmi2Error);
    CHECK(strstr(said, "fixed once the run has begun"));
    CHECK(set(c, HOST_REAL_OUTPUT, 1.0) == fmi2Error);
    CHECK(set(c, far_off, 1.0) == fmi2Error);
    CHECK(set(c, HOST_TEXT, 1.0) == fmi2Error);
    CHECK(fmi2GetReal(c, &far_off, 1, &value) == fmi2Error);
    CHECK(fmi2GetInteger(c, &output, 1, &whole) == fmi2Error);
    CHECK(fmi2GetReal(c, NULL, 1, &value) == fmi2Error);
    CHECK(fmi2GetReal(c, &output, 1, NULL) == fmi2Error);
    CHECK(fmi2GetReal(c, NULL, 0, NULL) == fmi2OK);
    CHECK(fmi2SetBoolean(c, &toggle, 1, &on) == fmi2OK);
    CHECK(fmi2GetBoolean(c, &toggle, 1, &whole) == fmi2OK && whole == fmi2True);
    value = 0.5;
    CHECK(fmi2SetRealInputDerivatives(c, &output, 1, &second, &value) == fmi2Error);
    CHECK(fmi2SetDebugLogging(c, fmi2True, 1, &unknown) == fmi2Error);
    fmi2FreeInstance(c);

    c = running(&talking);
    before = got(c, HOST_REAL_OUTPUT);
    for (int k = 0; k < 3; k++) {
        const double bad[] = {NAN, INFINITY, -INFINITY}, steps[] = {0.0, -0.1, NAN};
        CHECK(set(c, HOST_REAL_INPUT, bad[k]) == fmi2Discard);
        CHECK(strstr(said, "finite number in"));
        CHECK(got(c, HOST_REAL_INPUT) == 0.0);
        CHECK(fmi2DoStep(c, bad[k], 0.1, fmi2True) == fmi2Discard);
        CHECK(fmi2DoStep(c, 0.0, steps[k], fmi2True) == fmi2Discard);
        CHECK(strstr(said, "above zero"));
    }
    CHECK(fmi2DoStep(c, 0.5, 0.1, fmi2True) == fmi2Discard);
    CHECK(fmi2DoStep(c, 0.0, INFINITY, fmi2True) == fmi2Discard);
    CHECK(fmi2DoStep(c, 0.0, 1e300, fmi2True) == fmi2Discard);
    CHECK(fmi2DoStep(c, 0.0, 1e5, fmi2True) == fmi2Discard);
    CHECK(strstr(said, "internal steps, more than " TEXT(MOST_STEPS)));
    CHECK(fmi2GetRealStatus(c, fmi2LastSuccessfulTime, &value) == fmi2OK && value == 0.0);
    CHECK(got(c, HOST_REAL_OUTPUT) == before);
    CHECK(fmi2GetFMUstate(c, &state) == fmi2OK);
    for (int k = 0; k < 4; k++) { /* A repeated step ends a run, but not after a state was set or a reset. */
        CHECK(set(c, HOST_REAL_INPUT, 1e300) == fmi2OK); /* finite, but no motion bears it */
        CHECK(fmi2DoStep(c, 0.0, 0.1, fmi2True) == fmi2Discard);
        CHECK(fmi2GetBooleanStatus(c, fmi2Terminated, &whole) == fmi2OK && whole == (k == 1));
        if (k == 1)
            CHECK(fmi2SetFMUstate(c, state) == fmi2OK);
        if (k == 2)
            CHECK(fmi2Reset(c) == fmi2OK && begun(c) == fmi2OK);
    }
    CHECK(fmi2FreeFMUstate(c, &state) == fmi2OK);
    CHECK(set(c, HOST_REAL_INPUT, 0.0) == fmi2OK);
    CHECK(got(c, HOST_REAL_OUTPUT) == before);
    CHECK(fmi2DoStep(c, 0.0, 0.1, fmi2True) == fmi2OK);
    CHECK(fmi2GetRealStatus(c, fmi2LastSuccessfulTime, &value) == fmi2OK && value == 0.1);
    CHECK(fmi2GetBooleanStatus(c, fmi2Terminated, &whole) == fmi2OK && whole == fmi2False);
    fmi2FreeInstance(c);
}

static void states(void)
{
    fmi2Component c = running(&talking), other = made();
    fmi2FMUstate state = NULL, again = NULL, foreign;
    unsigned long nothing[8] = {0};
    fmi2Byte *bytes;
    size_t size = 0;
    double after;
    CHECK(fmi2DoStep(c, 0.0, 0.1, fmi2True) == fmi2OK);
    CHECK(fmi2GetFMUstate(c, &state) == fmi2OK);
    CHECK(fmi2GetFMUstate(c, &state) == fmi2OK); /* over the first */
    CHECK(fmi2SerializedFMUstateSize(c, state, &size) == fmi2OK);
    bytes = malloc(size);
    CHECK(fmi2SerializeFMUstate(c, state, bytes, size - 1) == fmi2Error);
    CHECK(fmi2SerializeFMUstate(c, state, bytes, size) == fmi2OK);
    CHECK(fmi2DoStep(c, 0.1, 0.1, fmi2True) == fmi2OK);
    after = got(c, HOST_REAL_OUTPUT);
    CHECK(fmi2SetFMUstate(c, state) == fmi2OK);
    CHECK(fmi2DoStep(c, 0.1, 0.1, fmi2True) == fmi2OK);
    CHECK(got(c, HOST_REAL_OUTPUT) == after);
    CHECK(fmi2DeSerializeFMUstate(other, bytes, size, &again) == fmi2OK);
    CHECK(fmi2SetFMUstate(other, again) == fmi2OK); /* takes the phase over too */
    CHECK(fmi2DoStep(other, 0.1, 0.1, fmi2True) == fmi2OK);
    CHECK(got(other, HOST_REAL_OUTPUT) == after);
    foreign = nothing;
    CHECK(fmi2SetFMUstate(c, foreign) == fmi2Error);
    CHECK(fmi2SetFMUstate(c, NULL) == fmi2Error);
    CHECK(fmi2FreeFMUstate(c, &foreign) == fmi2Error);
    CHECK(fmi2FreeFMUstate(c, &again) == fmi2OK && !again);
    CHECK(fmi2FreeFMUstate(c, &again) == fmi2OK);
    CHECK(fmi2GetFMUstate(c, &again) == fmi2OK);
    CHECK(fmi2FreeFMUstate(c, again) == fmi2OK); /* as fmusim 0.0.39 does */
    again = NULL;
    CHECK(fmi2DeSerializeFMUstate(c, bytes, size - 8, &again) == fmi2Error);
    for (size_t k = 0; k < 128; k++) { /* the heads */
        bytes[k] = (fmi2Byte)(bytes[k] ^ 0x55);
        if (fmi2DeSerializeFMUstate(c, bytes, size, &again) == fmi2OK) {
            fmi2SetFMUstate(c, again);
            fmi2FreeFMUstate(c, &again);
        }
        bytes[k] = (fmi2Byte)(bytes[k] ^ 0x55);
    }
    CHECK(fmi2SetFMUstate(c, state) == fmi2OK);
    CHECK(fmi2DoStep(c, 0.1, 0.1, fmi2True) == fmi2OK);
    CHECK(got(c, HOST_REAL_OUTPUT) == after);
    CHECK(fmi2FreeFMUstate(c, &state) == fmi2OK);
    free(bytes);
    fmi2FreeInstance(c);
    fmi2FreeInstance(other);
}

static void many(void)
{
    for (int k = 0; k < INSTANCES; k++) {
        fmi2Component c = k % 100 ? made() : running(&talking);
        if (!c)
            failures++;
        fmi2FreeInstance(c);
    }
}

static void *run(void *result)
{
    fmi2Component c = running(&quiet);
    double *y = result;
    for (int k = 0; k < STEPS; k++) {
        const fmi2ValueReference toggle = HOST_SWITCH;
        const int on = k > STEPS / 2;
        set(c, HOST_REAL_INPUT, 0.3 * sin(k));
        fmi2SetBoolean(c, &toggle, 1, &on);
        if (fmi2DoStep(c, 0.01 * k, 0.01, fmi2True) != fmi2OK)
            *y = NAN;
        *y += got(c, HOST_REAL_OUTPUT);
    }
    fmi2FreeInstance(c);
    return NULL;
}

static void threads(void)
{
    pthread_t each[THREADS];
    double alone = 0.0, y[THREADS] = {0.0};
    run(&alone);
    for (int k = 0; k < THREADS; k++)
        pthread_create(&each[k], NULL, run, &y[k]);
    for (int k = 0; k < THREADS; k++) {
        pthread_join(each[k], NULL);
        CHECK(y[k] == alone);
    }
}

int main(void)
{
    instantiation();
    bad_handles();
    illegal_orders();
    bad_values();
    states();
    many();
    threads();
    return failures;
}
