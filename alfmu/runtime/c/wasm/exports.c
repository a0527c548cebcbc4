/* The functions of FMI 3 as exports of a WebAssembly component, by the draft of FMI-LS-WASM (fmi3.wit).

   A result of more than one value is written into `area`: a failure flag, then the status or the values. The host
   allocates list and string arguments by `cabi_realloc`; each function frees them when it returns. */

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3.c"

#define EXPORT(NAME) __attribute__((export_name(NAME)))
#define IMPORT(MODULE, NAME) __attribute__((import_module(MODULE), import_name(NAME)))
#define CS "fmi:fmi3/co-simulation@3.0.0"
#define ME "fmi:fmi3/model-exchange@3.0.0"
#define CALLBACKS "fmi:fmi3/callbacks@3.0.0"

typedef struct {
    fmi3Instance instance;
    char name[];
} Owner;

typedef struct {
    const char *text;
    size_t length;
} Text;

IMPORT(CALLBACKS, "log-message")
void log_message(const char *name, size_t name_length, int status, const char *category, size_t category_length,
    const char *text, size_t length);
IMPORT("fmi:fmi3/intermediate-update-callbacks@3.0.0", "intermediate-update")
void intermediate_update(double time, int set, int get, int finished, int can_return, void *answer);
IMPORT("[export]" CS, "[resource-new]co-simulation-instance") int new_cs(Owner *o);
IMPORT("[export]" ME, "[resource-new]model-exchange-instance") int new_me(Owner *o);

/* Memory of arguments. A zero after each block terminates strings. */
typedef struct Block {
    struct Block *next;
    uint64_t bytes[];
} Block;

static Block *blocks;

EXPORT("cabi_realloc") void *cabi_realloc(void *old, size_t old_size, size_t alignment, size_t size)
{
    Block *b = malloc(sizeof *b + size + 1);
    (void)alignment;
    if (!b)
        __builtin_trap();
    if (old)
        memcpy(b->bytes, old, old_size < size ? old_size : size);
    ((char *)b->bytes)[size] = 0;
    b->next = blocks;
    blocks = b;
    return b->bytes;
}

static void give_back(void)
{
    while (blocks) {
        Block *b = blocks;
        blocks = b->next;
        free(b);
    }
}

/* The result of a call, which the host copies before the next call. */
static union {
    unsigned char bytes[32];
    uint32_t words[8];
    uint64_t counts[4];
    double numbers[4];
} area;

static void *values;

static void *room(size_t count, size_t size)
{
    free(values);
    values = malloc(count * size + 1);
    if (!values)
        __builtin_trap();
    return values;
}

static void *answer(fmi3Status status, size_t place)
{
    area.bytes[0] = status > fmi3Warning;
    if (area.bytes[0])
        area.bytes[place] = (unsigned char)status;
    give_back();
    return &area;
}

static void *list(fmi3Status status, size_t count)
{
    area.words[1] = (uint32_t)(uintptr_t)values;
    area.words[2] = (uint32_t)count;
    return answer(status, 4);
}

static fmi3Status finished(fmi3Status status)
{
    give_back();
    return status;
}

/* Instances -------------------------------------------------------------------------------------------------------- */

static void told(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String text)
{
    const Owner *o = environment;
    log_message(o->name, strlen(o->name), (int)status, category, strlen(category), text, strlen(text));
}

static void updated(fmi3InstanceEnvironment environment, fmi3Float64 time, fmi3Boolean set, fmi3Boolean get,
    fmi3Boolean finished, fmi3Boolean can_return, fmi3Boolean *wanted, fmi3Float64 *from)
{
    struct {
        unsigned char wanted;
        double from;
    } said = {0, time};
    (void)environment;
    intermediate_update(time, set, get, finished, can_return, &said);
    *wanted = said.wanted != 0;
    *from = said.from;
}

/* Arguments of every instantiation. The host passes no address for an empty string; the resource path is unused. */
#define OWNED \
    const char *name, size_t name_length, const char *token, size_t token_length, const char *path, \
        size_t path_length, int visible, int logging
#define NEW_OWNER \
    Owner *o = malloc(sizeof *o + name_length + 1); \
    if (!o) \
        __builtin_trap(); \
    memcpy(o->name, name_length ? name : "", name_length + 1); \
    token = token_length ? token : ""; \
    (void)path; \
    (void)path_length;

static void *owned(Owner *o, int (*give)(Owner *))
{
    area.bytes[0] = o->instance != NULL;
    if (o->instance)
        area.words[1] = (uint32_t)give(o);
    else
        free(o);
    give_back();
    return &area;
}

/* Intermediate updates are sent only to hosts that allow early return or name intermediate variables. */
EXPORT(CS "#[static]co-simulation-instance.instantiate-co-simulation")
void *instantiate_cs(OWNED, int events, int may_return, const fmi3ValueReference *between, size_t between_count)
{
    NEW_OWNER
    o->instance = fmi3InstantiateCoSimulation(o->name, token, NULL, visible != 0, logging != 0, events != 0,
        may_return != 0, between, between_count, o, told, may_return || between_count ? updated : NULL);
    return owned(o, new_cs);
}

EXPORT(ME "#[static]model-exchange-instance.instantiate-model-exchange")
void *instantiate_me(OWNED)
{
    NEW_OWNER
    o->instance = fmi3InstantiateModelExchange(o->name, token, NULL, visible != 0, logging != 0, o, told);
    return owned(o, new_me);
}

static void drop(Owner *o)
{
    fmi3FreeInstance(o->instance);
    free(o);
}

EXPORT(CS "#[dtor]co-simulation-instance") void drop_cs(Owner *o) { drop(o); }
EXPORT(ME "#[dtor]model-exchange-instance") void drop_me(Owner *o) { drop(o); }

EXPORT("fmi:fmi3/common@3.0.0#get-version") void *get_version(void)
{
    area.words[0] = (uint32_t)(uintptr_t)fmi3GetVersion();
    area.words[1] = (uint32_t)strlen(fmi3GetVersion());
    return &area;
}

/* Methods of both kinds of instances ------------------------------------------------------------------------------- */

/* A method of both interfaces, with its arguments as declared and as passed on. */
#define CS_METHOD(NAME) EXPORT(CS "#[method]co-simulation-instance." NAME)
#define ME_METHOD(NAME) EXPORT(ME "#[method]model-exchange-instance." NAME)
#define METHOD(RESULT, FUNCTION, NAME, DECLARED, PASSED) \
    static RESULT FUNCTION DECLARED; \
    CS_METHOD(NAME) RESULT cs_##FUNCTION DECLARED { return FUNCTION PASSED; } \
    ME_METHOD(NAME) RESULT me_##FUNCTION DECLARED { return FUNCTION PASSED; } \
    static RESULT FUNCTION DECLARED

#define CALL(FUNCTION, NAME) \
    METHOD(int, own_##FUNCTION, NAME, (Owner * o), (o)) { return finished(FUNCTION(o->instance)); }

CALL(fmi3ExitInitializationMode, "exit-initialization-mode")
CALL(fmi3EnterEventMode, "enter-event-mode")
CALL(fmi3EnterStepMode, "enter-step-mode")
CALL(fmi3Terminate, "terminate")
CALL(fmi3Reset, "reset")
CALL(fmi3EnterConfigurationMode, "enter-configuration-mode")
CALL(fmi3ExitConfigurationMode, "exit-configuration-mode")
CALL(fmi3EvaluateDiscreteStates, "evaluate-discrete-states")

METHOD(int, set_logging, "set-debug-logging", (Owner * o, int on, Text *texts, size_t count), (o, on, texts, count))
{
    const char **categories = room(count, sizeof *categories);
    for (size_t k = 0; k < count; k++)
        categories[k] = texts[k].length ? texts[k].text : "";
    return finished(fmi3SetDebugLogging(o->instance, on != 0, count, categories));
}

METHOD(int, initialize, "enter-initialization-mode",
    (Owner * o, int bounded, double tolerance, double start, int stops, double stop),
    (o, bounded, tolerance, start, stops, stop))
{
    return finished(fmi3EnterInitializationMode(o->instance, bounded != 0, tolerance, start, stops != 0, stop));
}

METHOD(void *, update, "update-discrete-states", (Owner * o), (o))
{
    bool *b = (bool *)area.bytes + 8;
    return answer(fmi3UpdateDiscreteStates(o->instance, b, b + 1, b + 2, b + 3, b + 4, area.numbers + 2), 8);
}

#define ARGUMENTS(...) __VA_ARGS__

/* The getter and setter of a type: the C types of their values, and their last arguments. */
#define BOTH(TYPE, NAME, FOUND, GIVEN, LAST_OF_GET, LAST_OF_SET) \
    METHOD(void *, get_##TYPE, "get-" NAME, (Owner * o, REFERENCES), (o, references, count)) \
    { \
        FOUND *found = room(count, sizeof *found); \
        (void)found; \
        return list(fmi3Get##TYPE(o->instance, references, count, ARGUMENTS LAST_OF_GET), count); \
    } \
    METHOD(int, set_##TYPE, "set-" NAME, (Owner * o, REFERENCES, const GIVEN *given, size_t given_count), \
        (o, references, count, given, given_count)) \
    { \
        (void)given; \
        (void)given_count; \
        return finished(fmi3Set##TYPE(o->instance, references, count, ARGUMENTS LAST_OF_SET)); \
    }
#define NUMBERS(TYPE, NAME) BOTH(TYPE, NAME, fmi3##TYPE, fmi3##TYPE, (found, count), (given, given_count))

NUMBERS(Float32, "float32")
NUMBERS(Float64, "float64")
NUMBERS(Int8, "int8")
NUMBERS(Int16, "int16")
NUMBERS(Int32, "int32")
NUMBERS(Int64, "int64")
NUMBERS(UInt8, "uint8")
NUMBERS(UInt16, "uint16")
NUMBERS(UInt32, "uint32")
NUMBERS(UInt64, "uint64")
NUMBERS(Boolean, "boolean")

/* No variable has these types: the functions refuse every reference. */
BOTH(String, "string", fmi3String, Text, (NULL, count), (NULL, given_count))
BOTH(Binary, "binary", fmi3Binary, Text, (NULL, NULL, count), (NULL, NULL, given_count))
BOTH(Clock, "clock", fmi3Clock, fmi3Clock, (NULL), (NULL))
BOTH(IntervalDecimal, "interval-decimal", double, double, (NULL, NULL), (NULL))
BOTH(IntervalFraction, "interval-fraction", double, double, (NULL, NULL, NULL), (NULL, NULL))
BOTH(ShiftDecimal, "shift-decimal", double, double, (NULL), (NULL))
BOTH(ShiftFraction, "shift-fraction", double, double, (NULL, NULL), (NULL, NULL))

METHOD(void *, count_dependencies, "get-number-of-variable-dependencies", (Owner * o, unsigned reference),
    (o, reference))
{
    size_t found = 0;
    return answer(fmi3GetNumberOfVariableDependencies(o->instance, reference, &found), 8);
}

METHOD(void *, get_dependencies, "get-variable-dependencies", (Owner * o, unsigned reference), (o, reference))
{
    return list(fmi3GetVariableDependencies(o->instance, reference, NULL, NULL, NULL, NULL, 0), 0);
}

METHOD(void *, get_state, "get-fmu-state", (Owner * o), (o))
{
    fmi3FMUState state = NULL;
    size_t size = 0;
    fmi3Status made = fmi3GetFMUState(o->instance, &state);
    if (made <= fmi3Warning)
        made = fmi3SerializedFMUStateSize(o->instance, state, &size);
    if (made <= fmi3Warning)
        made = fmi3SerializeFMUState(o->instance, state, room(size, 1), size);
    fmi3FreeFMUState(o->instance, &state);
    return list(made, size);
}

METHOD(int, set_state, "set-fmu-state", (Owner * o, const fmi3Byte *bytes, size_t size), (o, bytes, size))
{
    fmi3FMUState state = NULL;
    fmi3Status made = fmi3DeserializeFMUState(o->instance, bytes, size, &state);
    if (made <= fmi3Warning)
        made = fmi3SetFMUState(o->instance, state);
    fmi3FreeFMUState(o->instance, &state);
    return finished(made);
}

#define DERIVATIVE(FUNCTION, NAME, COUNT) \
    METHOD(void *, own_##FUNCTION, NAME, \
        (Owner * o, REFERENCES, const unsigned *knowns, size_t known_count, const double *seed, size_t seeds), \
        (o, references, count, knowns, known_count, seed, seeds)) \
    { \
        double *found = room(COUNT, sizeof *found); \
        return list(FUNCTION(o->instance, references, count, knowns, known_count, seed, seeds, found, COUNT), COUNT); \
    }

DERIVATIVE(fmi3GetDirectionalDerivative, "get-directional-derivative", count)
DERIVATIVE(fmi3GetAdjointDerivative, "get-adjoint-derivative", known_count)

typedef struct {
    fmi3ValueReference reference;
    int order;
} Request;

METHOD(void *, get_output_derivatives, "get-output-derivatives", (Owner * o, const Request *requests, size_t count),
    (o, requests, count))
{
    fmi3Status made = fmi3OK;
    double *found = room(count, sizeof *found);
    for (size_t k = 0; k < count && made <= fmi3Warning; k++)
        made = fmi3GetOutputDerivatives(o->instance, &requests[k].reference, 1, &requests[k].order, found + k, 1);
    return list(made, count);
}

/* Co-simulation ---------------------------------------------------------------------------------------------------- */

/* FMI 3 has no function for input derivatives. */
CS_METHOD("set-input-derivatives")
int set_input_derivatives(Owner *o, const Request *requests, size_t count, const double *given, size_t given_count)
{
    return finished(none(o->instance, count + given_count, "fmi3SetInputDerivatives", requests, given));
}

CS_METHOD("do-step") void *do_step(Owner *o, double point, double step, int no_way_back)
{
    bool *b = (bool *)area.bytes + 16;
    return answer(fmi3DoStep(o->instance, point, step, no_way_back != 0, b, b + 1, b + 2, area.numbers + 1), 8);
}

/* Model Exchange --------------------------------------------------------------------------------------------------- */

#define COUNT(FUNCTION, NAME) \
    ME_METHOD(NAME) void *own_##FUNCTION(Owner *o) \
    { \
        size_t found = 0; \
        const fmi3Status made = FUNCTION(o->instance, &found); \
        area.counts[1] = found; \
        return answer(made, 8); \
    }
#define LIST(FUNCTION, NAME, SIZE) \
    ME_METHOD(NAME) void *own_##FUNCTION(Owner *o) \
    { \
        size_t size = 0; \
        fmi3Status made = SIZE(o->instance, &size); \
        if (made <= fmi3Warning) \
            made = FUNCTION(o->instance, room(size, sizeof(double)), size); \
        return list(made, size); \
    }
#define ACT(FUNCTION, NAME, DECLARED, ...) \
    ME_METHOD(NAME) int own_##FUNCTION DECLARED { return finished(FUNCTION(o->instance __VA_ARGS__)); }

COUNT(fmi3GetNumberOfEventIndicators, "get-number-of-event-indicators")
COUNT(fmi3GetNumberOfContinuousStates, "get-number-of-continuous-states")
LIST(fmi3GetContinuousStateDerivatives, "get-continuous-state-derivatives", fmi3GetNumberOfContinuousStates)
LIST(fmi3GetContinuousStates, "get-continuous-states", fmi3GetNumberOfContinuousStates)
LIST(fmi3GetNominalsOfContinuousStates, "get-nominals-of-continuous-states", fmi3GetNumberOfContinuousStates)
LIST(fmi3GetEventIndicators, "get-event-indicators", fmi3GetNumberOfEventIndicators)
ACT(fmi3EnterContinuousTimeMode, "enter-continuous-time-mode", (Owner * o), )
ACT(fmi3SetTime, "set-time", (Owner * o, double time), , time)
ACT(fmi3SetContinuousStates, "set-continuous-states", (Owner * o, const double *states, size_t count), , states, count)

ME_METHOD("completed-integrator-step") void *completed(Owner *o, int no_way_back)
{
    bool *b = (bool *)area.bytes + 1;
    return answer(fmi3CompletedIntegratorStep(o->instance, no_way_back != 0, b, b + 1), 1);
}
