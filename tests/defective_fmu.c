/* A mass on a spring as an FMU of FMI 2 or 3 (-DFMI=2, -DFMI=3), with the one defect that the environment variable DEFECT
   names. Without it the FMU is right in all that tests/test_validation.py asks.

   m a = u - k x - 0.4 v, from x = 1, v = 0. References: 0 m, 1 k, 2 mode, 3 u, 4 x, 5 v, 6 a, 7 count, 8 time (FMI 3). */

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define API __attribute__((visibility("default")))

enum { OK, WARNING, DISCARD, ERROR, FATAL };
enum { M, K, MODE, U, X, V, A, COUNT, TIME };
enum { NEW, ENTERED, RUNNING, ENDED };

typedef struct {
    double m, k, u, x, v, time;
    int mode, count;
} Values;

typedef struct {
    Values now;
    int phase, logging;
    void *environment;
    void *log;
} Model;

static int instances; /* since the process began */
static double shared; /* the speed of all instances, with the defect of that name */

static int defect(const char *name)
{
    const char *chosen = getenv("DEFECT");
    return chosen && !strcmp(chosen, name);
}

#if FMI == 2
typedef void Log(void *environment, const char *name, int status, const char *category, const char *text, ...);
#define F(name) fmi2##name
#define COUNTED
#define COUNTED_ARGUMENT
typedef int Truth;
#else
typedef void Log(void *environment, int status, const char *category, const char *text);
#define F(name) fmi3##name
#define COUNTED_ARGUMENT , size_t value_count
typedef bool Truth;
#endif

static int said(Model *c, int status, const char *text)
{
    if (c->logging && c->log && !defect("mute")) {
#if FMI == 2
        ((Log *)c->log)(c->environment, "spring", status, "problems", text);
#else
        ((Log *)c->log)(c->environment, status, "problems", text);
#endif
    }
    return status;
}

static Values *values(Model *c)
{
    return &c->now;
}

static void begin(Model *c)
{
    static int made = 0;
    const Values start = {2.0, 3.0, 0.0, 1.0, 0.0, 0.0, 1, 0};
    *values(c) = start;
    if (defect("random"))
        values(c)->x += 1e-9 * ++made;
    if (defect("start"))
        values(c)->m = 2.5;
    if (defect("digits"))
        values(c)->m = 2.0 + 8e-15;
    c->phase = NEW;
    shared = 0.0;
}

static int wrong_order(Model *c, int phase, const char *text)
{
    return c->phase != phase && !defect("any_order") ? said(c, ERROR, text) : OK;
}

static double acceleration(const Values *y, double x, double v)
{
    return (y->u - y->k * x - 0.4 * v) / y->m;
}

static void move(Values *y, double by)
{
    const int count = (int)ceil(by / 1e-3 - 1e-9);
    const double h = by / count;
    for (int i = 0; i < count; i++) {
        const double a1 = acceleration(y, y->x, y->v), v2 = y->v + h / 2 * a1;
        const double a2 = acceleration(y, y->x + h / 2 * y->v, v2), v3 = y->v + h / 2 * a2;
        const double a3 = acceleration(y, y->x + h / 2 * v2, v3), v4 = y->v + h * a3;
        const double a4 = acceleration(y, y->x + h * v3, v4);
        y->x += h / 6 * (y->v + 2 * v2 + 2 * v3 + v4);
        y->v += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4);
    }
}

/* Life ------------------------------------------------------------------------------------------------------------- */

static Model *made(void *log, void *environment, int logging)
{
    Model *c;
#if defined(ONCE)
    if (instances)
        return NULL;
#endif
    instances++;
    c = calloc(1, sizeof *c);
    c->log = log;
    c->environment = environment;
    c->logging = logging;
    begin(c);
    if (defect("leak"))
        memset(malloc(64000), 1, 64000);
    return c;
}

API const char *F(GetVersion)(void)
{
    return defect("version") ? "1.0" : FMI == 2 ? "2.0" : "3.0";
}

#if FMI == 2
typedef struct {
    Log *logger;
    void *allocate, *free, *finished, *environment;
} Callbacks;

API const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

API void *fmi2Instantiate(const char *name, int type, const char *guid, const char *folder, const Callbacks *callbacks,
    int visible, int logging)
{
    (void)name, (void)type, (void)guid, (void)folder, (void)visible;
    return defect("stillborn") ? NULL : made((void *)callbacks->logger, callbacks->environment, logging);
}

API int fmi2SetupExperiment(Model *c, int has_tolerance, double tolerance, double start, int has_stop, double stop)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    values(c)->time = start;
    return wrong_order(c, NEW, "set up after initialisation has begun");
}

API int fmi2EnterInitializationMode(Model *c)
{
    const int status = wrong_order(c, NEW, "initialisation has begun before");
    c->phase = ENTERED;
    return status;
}
#else
API void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *folder, bool visible, bool logging,
    bool events, bool early, const unsigned *between, size_t count, void *environment, void *log, void *update)
{
    (void)name, (void)token, (void)folder, (void)visible, (void)events, (void)early, (void)between, (void)count;
    (void)update;
    return defect("stillborn") ? NULL : made(log, environment, logging);
}

API int fmi3EnterInitializationMode(
    Model *c, bool has_tolerance, double tolerance, double start, bool has_stop, double stop)
{
    const int status = wrong_order(c, NEW, "initialisation has begun before");
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    values(c)->time = start;
    c->phase = ENTERED;
    return status;
}
#endif

API int F(ExitInitializationMode)(Model *c)
{
    const int status = wrong_order(c, ENTERED, "initialisation has not begun");
    if (defect("no_start"))
        return said(c, ERROR, "it will not start");
    if (defect("start_dependency"))
        values(c)->x += 0.1 * (values(c)->k - 3.0);
    c->phase = RUNNING;
    return status;
}

API int F(Terminate)(Model *c)
{
    const int status = wrong_order(c, RUNNING, "it does not run");
    c->phase = ENDED;
    if (defect("forget"))
        values(c)->x = 0.0;
    return status;
}

API int F(Reset)(Model *c)
{
    const double v = values(c)->v;
    begin(c);
    if (defect("half_reset"))
        values(c)->v = v;
    return OK;
}

API void F(FreeInstance)(Model *c)
{
    free(c);
}

API int F(SetDebugLogging)(Model *c, Truth on, size_t count, const char *const categories[])
{
    c->logging = on;
    for (size_t i = 0; i < count; i++)
        if (strcmp(categories[i], defect("category") ? "other" : "problems") && !defect("any_category"))
            return said(c, ERROR, "there is no such category");
    return OK;
}

/* Values ----------------------------------------------------------------------------------------------------------- */

static int real(unsigned reference)
{
    return reference == M || reference == K || (reference >= U && reference <= A) || (FMI == 3 && reference == TIME);
}

static double number(Model *c, unsigned reference)
{
    const Values *y = values(c);
    switch (reference) {
    case M:
        return y->m;
    case K:
        return y->k;
    case U:
        return y->u;
    case X:
        if (defect("digit")) /* the last one, in every other instance */
            return nextafter(y->x, instances % 2 ? INFINITY : -INFINITY);
        return defect("nan") && y->time > 0.05 ? NAN : y->x;
    case V:
        return y->v + (defect("undeclared") ? 1e-3 * y->u : 0.0);
    case A:
        return acceleration(y, y->x, y->v);
    default:
        return y->time;
    }
}

/* Of an unknown reference: an error, or the defects in its place. */
static int unknown(Model *c)
{
    if (defect("crash_reference"))
        *(volatile int *)NULL = 1;
    return defect("any_reference") ? OK : said(c, ERROR, "no variable has this reference");
}

#define GET(NAME, TYPE, HAS, VALUE) \
    API int F(Get##NAME)(Model * c, const unsigned references[], size_t count, TYPE out[] COUNTED_ARGUMENT) \
    { \
        (void)out; \
        if (FMI == 2 && c->phase == NEW) \
            return said(c, ERROR, "not before initialisation"); \
        for (size_t i = 0; i < count; i++) { \
            const unsigned r = references[i]; \
            if (!(HAS)) { \
                if (r > TIME || !defect("any_type")) { \
                    const int status = unknown(c); \
                    if (status) \
                        return status; \
                } \
                continue; \
            } \
            out[i] = (VALUE); \
        } \
        return OK; \
    }

static int set_real(Model *c, unsigned r, double value)
{
    Values *y = values(c);
    if (!real(r))
        return defect("any_set") ? OK : said(c, ERROR, "no variable has this reference");
    if (r >= X)
        return defect("set_output") ? OK : said(c, ERROR, "an output cannot be set");
    if (r != U && c->phase == RUNNING && !defect("set_fixed"))
        return said(c, ERROR, "a parameter is fixed");
    if (!isfinite(value) && !defect("nonfinite") && !defect("stuck"))
        return said(c, DISCARD, "the value is no number");
    if (r == M && !(value >= 0.1 && value <= 10.0)) {
        if (!defect("bounds"))
            return said(c, DISCARD, "m is out of bounds");
        value = NAN;
    }
    if (r == U && fabs(value) > 100.0)
        value = copysign(100.0, value);
    *(r == M ? &y->m : r == K ? &y->k : &y->u) = value;
    return OK;
}

static int set_mode(Model *c, unsigned r, int64_t value)
{
    if (r == COUNT)
        return defect("set_output") ? OK : said(c, ERROR, "an output cannot be set");
    if (r != MODE)
        return defect("any_set") ? OK : said(c, ERROR, "no variable has this reference");
    if (c->phase == RUNNING && !defect("set_fixed"))
        return said(c, ERROR, "a parameter is fixed");
    if ((value < 1 || value > 2) && !defect("item"))
        return said(c, DISCARD, "this is no item");
    values(c)->mode = (int)value;
    return OK;
}

static int set_none(Model *c)
{
    return defect("any_set") ? OK : said(c, ERROR, "no variable has this type");
}

#define SET(NAME, TYPE, CALL) \
    API int F(Set##NAME)(Model * c, const unsigned references[], size_t count, const TYPE in[] COUNTED_ARGUMENT) \
    { \
        int status = OK; \
        (void)references, (void)in; \
        for (size_t i = 0; i < count && status < DISCARD; i++) \
            status = CALL; \
        return status; \
    }

#define NONE(NAME, TYPE) \
    GET(NAME, TYPE, r == ~0u && !references, 0) \
    SET(NAME, TYPE, set_none(c))

#define TALLY (defect("count") ? -1 : values(c)->count)

#if FMI == 2
GET(Real, double, real(r), number(c, r))
SET(Real, double, set_real(c, references[i], in[i]))
GET(Integer, int, r == MODE || r == COUNT, r == MODE ? values(c)->mode : TALLY)
SET(Integer, int, set_mode(c, references[i], in[i]))
NONE(Boolean, int)
NONE(String, const char *)
#else
GET(Float64, double, real(r), number(c, r))
SET(Float64, double, set_real(c, references[i], in[i]))
GET(Int32, int32_t, r == COUNT, TALLY)
SET(Int32, int32_t, set_mode(c, references[i] == MODE ? 99 : references[i], in[i]))
GET(Int64, int64_t, r == MODE, values(c)->mode)
SET(Int64, int64_t, set_mode(c, references[i] == COUNT ? 99 : references[i], in[i]))
NONE(Float32, float)
NONE(Int8, int8_t)
NONE(UInt8, uint8_t)
NONE(Int16, int16_t)
NONE(UInt16, uint16_t)
NONE(UInt32, uint32_t)
NONE(UInt64, uint64_t)
NONE(Boolean, bool)
NONE(String, const char *)
#endif

/* Steps ------------------------------------------------------------------------------------------------------------ */

static int stepped(Model *c, double point, double size)
{
    Values *y = values(c);
    if (wrong_order(c, RUNNING, "it does not run"))
        return ERROR;
    if (defect("exit"))
        exit(0);
    while (defect("hang") || (defect("stuck") && !isfinite(y->u)))
        ;
    if (defect("abort") && y->count == 2)
        abort();
    if (size <= 0.0 && !(defect("zero") && size == 0.0) && !(defect("negative") && size < 0.0))
        return said(c, ERROR, "a step has a length");
    if (fabs(point - y->time) > 1e-9 * (1.0 + fabs(point))) {
        if (!defect("elsewhere"))
            return said(c, ERROR, "the step does not begin where the last one ended");
        y->x = NAN;
    }
    if (defect("shared"))
        y->v = shared;
    if (size > 0.0)
        move(y, defect("steps") ? 0.1 : size);
    y->time = point + size;
    y->count++;
    shared = y->v;
    return OK;
}

#if FMI == 2
API int fmi2DoStep(Model *c, double point, double size, int no_way_back)
{
    (void)no_way_back;
    return stepped(c, point, size);
}
#else
API int fmi3DoStep(
    Model *c, double point, double size, bool no_way_back, bool *events, bool *end, bool *early, double *reached)
{
    (void)no_way_back;
    *events = *end = *early = false;
    const int status = stepped(c, point, size);
    *reached = values(c)->time;
    return status;
}
#endif

/* State ------------------------------------------------------------------------------------------------------------ */

#if FMI == 2
#define STATE(before, after) fmi2##before##FMUstate##after
#define READ fmi2DeSerializeFMUstate
#else
#define STATE(before, after) fmi3##before##FMUState##after
#define READ fmi3DeserializeFMUState
#endif

typedef struct {
    Values values;
    int phase;
} Saved;

API int STATE(Get, )(Model *c, void **state)
{
    Saved *saved = *state ? *state : malloc(sizeof *saved);
    if (defect("no_state"))
        return said(c, ERROR, "there are no states");
    saved->values = *values(c);
    saved->phase = c->phase;
    *state = saved;
    return OK;
}

API int STATE(Set, )(Model *c, const Saved *state)
{
    const double v = values(c)->v;
    *values(c) = state->values;
    c->phase = state->phase;
    if (defect("part_state"))
        values(c)->v = v;
    return OK;
}

API int STATE(Free, )(Model *c, void **state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return OK;
}

API int STATE(Serialized, Size)(Model *c, const Saved *state, size_t *size)
{
    (void)c, (void)state;
    *size = sizeof *state;
    return OK;
}

API int STATE(Serialize, )(Model *c, const Saved *state, unsigned char *bytes, size_t size)
{
    (void)c;
    memcpy(bytes, state, size);
    if (defect("bytes"))
        ((Saved *)bytes)->values.v = 0.0;
    return OK;
}

API int READ(Model *c, const unsigned char *bytes, size_t size, void **state)
{
    (void)c;
    *state = malloc(size);
    memcpy(*state, bytes, size);
    return OK;
}

/* Derivatives ------------------------------------------------------------------------------------------------------ */

static double partial(Model *c, unsigned output, unsigned input)
{
    return output == A && input == U ? (defect("derivative") ? 2.0 : 1.0) / values(c)->m : 0.0;
}

static double slope(Model *c, unsigned output)
{
    const Values *y = values(c);
    const double a = acceleration(y, y->x, y->v);
    return output == X ? y->v : output == V ? a * (defect("slope") ? 1.1 : 1.0) : -(y->k * y->v + 0.4 * a) / y->m;
}

#if FMI == 2
API int fmi2GetDirectionalDerivative(Model *c, const unsigned unknowns[], size_t unknown_count, const unsigned knowns[],
    size_t known_count, const double seed[], double out[])
#else
API int fmi3GetDirectionalDerivative(Model *c, const unsigned unknowns[], size_t unknown_count, const unsigned knowns[],
    size_t known_count, const double seed[], size_t seed_count, double out[], size_t out_count)
#endif
{
    for (size_t i = 0; i < unknown_count; i++) {
        out[i] = 0.0;
        for (size_t j = 0; j < known_count; j++)
            out[i] += partial(c, unknowns[i], knowns[j]) * seed[j];
    }
    return OK;
}

#if FMI == 2
API int fmi2GetRealOutputDerivatives(
    Model *c, const unsigned references[], size_t count, const int orders[], double out[])
#else
API int fmi3GetOutputDerivatives(Model *c, const unsigned references[], size_t count, const int orders[], double out[],
    size_t out_count)
#endif
{
    for (size_t i = 0; i < count; i++) {
        if (orders[i] != 1 && !defect("orders"))
            return said(c, ERROR, "there are first derivatives alone");
        out[i] = slope(c, references[i]);
    }
    return OK;
}

/* What this FMU has not. */
#define STUB(NAME) \
    API int F(NAME)(Model * c) \
    { \
        return said(c, ERROR, "this FMU has nothing of the kind"); \
    }

#if FMI == 2
API int fmi2SetRealInputDerivatives(Model *c, const unsigned r[], size_t count, const int orders[], const double in[])
{
    (void)r, (void)count, (void)orders, (void)in;
    return said(c, ERROR, "inputs have no derivatives");
}
#ifndef MISSING
STUB(CancelStep)
#endif
STUB(GetStatus)
STUB(GetRealStatus)
STUB(GetIntegerStatus)
STUB(GetBooleanStatus)
STUB(GetStringStatus)
#else
API int fmi3GetAdjointDerivative(Model *c, const unsigned unknowns[], size_t unknown_count, const unsigned knowns[],
    size_t known_count, const double seed[], size_t seed_count, double out[], size_t out_count)
{
    for (size_t j = 0; j < known_count; j++) {
        out[j] = 0.0;
        for (size_t i = 0; i < unknown_count; i++)
            out[j] += (defect("adjoint") ? -1.0 : 1.0) * partial(c, unknowns[i], knowns[j]) * seed[i];
    }
    return OK;
}
#ifndef MISSING
STUB(EnterEventMode)
#endif
STUB(InstantiateModelExchange)
STUB(InstantiateScheduledExecution)
STUB(GetBinary)
STUB(SetBinary)
STUB(GetClock)
STUB(SetClock)
STUB(GetNumberOfVariableDependencies)
STUB(GetVariableDependencies)
STUB(EnterConfigurationMode)
STUB(ExitConfigurationMode)
STUB(GetIntervalDecimal)
STUB(GetIntervalFraction)
STUB(GetShiftDecimal)
STUB(GetShiftFraction)
STUB(SetIntervalDecimal)
STUB(SetIntervalFraction)
STUB(SetShiftDecimal)
STUB(SetShiftFraction)
STUB(EvaluateDiscreteStates)
STUB(UpdateDiscreteStates)
STUB(EnterContinuousTimeMode)
STUB(CompletedIntegratorStep)
STUB(SetTime)
STUB(SetContinuousStates)
STUB(GetContinuousStateDerivatives)
STUB(GetEventIndicators)
STUB(GetContinuousStates)
STUB(GetNominalsOfContinuousStates)
STUB(GetNumberOfEventIndicators)
STUB(GetNumberOfContinuousStates)
STUB(EnterStepMode)
STUB(ActivateModelPartition)
#endif
