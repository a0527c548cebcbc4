/* Calls every function of a native FMU in legal and illegal order, with values, references, sizes, times and states
   that make sense or do not, and compares each status with the expected ones. Linked with the runtime, under
   sanitizers. FUZZ_FMI is 2 or 3. argv: GUID, seed, calls, threads, number of variables, first and number of the Real
   inputs, first and number of the Real outputs. The unpacked FMU is beside the program, in a folder with its name
   without the suffix. Prints the seed, the number of calls, the number of each status, the longest call, and all
   failures; returns 1 if there are any. The same arguments make the same calls.

   tests/test_scene.py tests damaged scene files. */

#include <math.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#define LONGEST_PATH 4096

#define SLOTS 3
#define MOST_VALUES 6
#define PATIENCE 60 /* seconds that a call may take under sanitizers */

enum { OK, WARNING, DISCARD, ERROR_, STATUSES = 6 };
enum { NONE = 0, BORN = 1, INITIALIZING = 2, STEPPING = 4, TERMINATED = 8, RUN = 12, ANY = 15 };

/* An instance, and the expected phase and time. */
typedef struct {
    void *handle;
    int phase;
    double time, stop; /* INFINITY without a stop time */
} Unit;

/* A thread with instances, states and random numbers of its own. */
typedef struct Fuzz {
    uint64_t random;
    long calls, made, steps, counts[STATUSES];
    int failures, inside, status;
    double begin, longest;
    char last[40], slowest[40];
    Unit units[SLOTS];
    void *states[SLOTS];
    int state_phase[SLOTS], bytes_phase[SLOTS]; /* -1 if a number was changed */
    unsigned char *bytes[SLOTS];
    size_t sizes[SLOTS];
} Fuzz;

static const char *guid;
static char resources[LONGEST_PATH + 64]; /* a URI, as FMI 2 has it, or a path as FMI 3 */
static unsigned total, first_input, inputs, first_output, outputs;

/* Chance ----------------------------------------------------------------------------------------------------------- */

static uint64_t next(Fuzz *f)
{
    f->random ^= f->random >> 12;
    f->random ^= f->random << 25;
    f->random ^= f->random >> 27;
    return f->random * 0x2545f4914f6cdd1du;
}

static unsigned below(Fuzz *f, unsigned most)
{
    return most ? (unsigned)((next(f) >> 33) % most) : 0;
}

static int one_in(Fuzz *f, unsigned most)
{
    return below(f, most) == 0;
}

static double unit(Fuzz *f)
{
    return (double)(next(f) >> 11) / 9007199254740992.0;
}

/* Return a random number of any size, or a special one. */
static double nonsense(Fuzz *f)
{
    static const double odd[] = {0.0, -0.0, 1.0, -1.0, 1e-320, 1e-9, 1e6, 2147483648.0, -1e15, 1e30, 1e100, 1e300,
        -1e300, 1.7e308, INFINITY, -INFINITY, NAN};
    const unsigned k = below(f, 24);
    double made;
    if (k < sizeof odd / sizeof *odd)
        return odd[k];
    if (k < 22)
        return 10.0 * (unit(f) - 0.5);
    {
        const uint64_t bits = next(f);
        memcpy(&made, &bits, sizeof made);
    }
    return made;
}

static double value_of(Fuzz *f)
{
    return one_in(f, 4) ? nonsense(f) : 2.0 * (unit(f) - 0.5);
}

static void nonsense_bytes(Fuzz *f, unsigned char *bytes, size_t size)
{
    for (unsigned k = 1 + below(f, 4); size && k > 0; k--)
        bytes[next(f) % size] ^= (unsigned char)(1u << below(f, 8));
}

/* Judging ---------------------------------------------------------------------------------------------------------- */

static void wrong(Fuzz *f, const char *what)
{
    f->failures++;
    if (f->failures < 20)
        printf("call %ld, %s: %s\n", f->made, f->last, what);
}

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Count a call and its status, which must be one of `expected` (as bits). */
static int judged(Fuzz *f, const char *name, int status, int expected)
{
    const double took = now() - f->begin;
    char text[80];
    f->made++;
    snprintf(f->last, sizeof f->last, "%s", name);
    if (took > f->longest && !f->inside) {
        f->longest = took;
        snprintf(f->slowest, sizeof f->slowest, "%s", name);
    }
    if (status < 0 || status >= STATUSES) {
        wrong(f, "an unknown status");
        return ERROR_;
    }
    f->counts[status]++;
    if (!(expected & (1 << status))) {
        snprintf(text, sizeof text, "status %d is not among those of %d", status, expected);
        wrong(f, text);
    }
    return status;
}

#define ONLY(STATUS) (1 << (STATUS))
#define ALL (ONLY(OK) | ONLY(WARNING) | ONLY(DISCARD) | ONLY(ERROR_))
#define CALLED(NAME, EXPECTED, ...) \
    (begins(f), f->status = (int)NAME(__VA_ARGS__), judged(f, #NAME, f->status, EXPECTED))

static void begins(Fuzz *f)
{
    if (f->inside)
        return;
    f->begin = now();
    alarm(PATIENCE);
}

static void checked_text(const char *text)
{
    if (!text || !*text || strchr(text, '%') || strlen(text) > 2000)
        abort();
}

static Unit *unit_of(Fuzz *f, const void *handle)
{
    for (int k = 0; k < SLOTS; k++)
        if (f->units[k].handle == handle)
            return f->units + k;
    return NULL;
}

/* Return the statuses that a step may have: one past the stop time is an error. */
static int of_step(const Unit *u, int expected, double point, double h)
{
    return u && expected != ALL && point + h > u->stop ? expected | ONLY(ERROR_) : expected;
}

/* The calls that both versions have -------------------------------------------------------------------------------- */

#if FUZZ_FMI == 2

#include "fmi2Functions.h"

#define ENTER fmi2EnterInitializationMode
#define LEAVE fmi2ExitInitializationMode
#define TERMINATE fmi2Terminate
#define RESET fmi2Reset
#define FREE fmi2FreeInstance
#define SAVE fmi2GetFMUstate
#define RESTORE fmi2SetFMUstate
#define FORGET fmi2FreeFMUstate
#define SIZE fmi2SerializedFMUstateSize
#define WRITE fmi2SerializeFMUstate
#define READ fmi2DeSerializeFMUstate
#define DEBUG fmi2SetDebugLogging
#define OUTPUT_DERIVATIVES(c, r, n, o, y, m) fmi2GetRealOutputDerivatives(c, r, n, o, y)
#define DERIVATIVE(c, u, nu, k, nk, d, nd, y, ny) fmi2GetDirectionalDerivative(c, u, nu, k, nk, d, y)
#define GET_FLOATS(c, r, n, y, m) fmi2GetReal(c, r, n, y)
#define SET_FLOATS(c, r, n, y, m) fmi2SetReal(c, r, n, y)
#define GET_INTS(c, r, n, y, m) fmi2GetInteger(c, r, n, y)
#define SET_INTS(c, r, n, y, m) fmi2SetInteger(c, r, n, y)
#define GET_TRUTHS(c, r, n, y, m) fmi2GetBoolean(c, r, n, y)
#define SET_TRUTHS(c, r, n, y, m) fmi2SetBoolean(c, r, n, y)
#define SAME_COUNTS 1 /* of values and references, always */
typedef fmi2Boolean Truth;
typedef fmi2Byte Byte;

static void logged(
    fmi2ComponentEnvironment host, fmi2String name, fmi2Status status, fmi2String category, fmi2String text, ...)
{
    (void)host;
    (void)name;
    (void)status;
    (void)category;
    checked_text(text);
}

static void *made(Fuzz *f, int bad)
{
    static const fmi2CallbackFunctions functions = {logged, calloc, free, NULL, NULL};
    void *c;
    alarm(PATIENCE);
    c = fmi2Instantiate(bad == 1 ? NULL : bad == 2 ? "" : "one", bad == 3 ? (fmi2Type)2 : fmi2CoSimulation,
        bad == 4 ? "other" : bad == 5 ? NULL : guid, resources, one_in(f, 8) ? NULL : &functions, fmi2False,
        (fmi2Boolean)below(f, 2));
    f->made++;
    return c;
}

#define BEGIN(EXPECTED, HAS_STOP, STOP) \
    CALLED(fmi2SetupExperiment, EXPECTED, c, has_tolerance, tolerance, start, HAS_STOP, STOP)

static int begin(Fuzz *f, void *c, int expected, int has_tolerance, double tolerance, double start);

static int entered(Fuzz *f, void *c, int expected, double start)
{
    if (one_in(f, 2))
        begin(f, c, expected & ONLY(ERROR_) ? expected : expected | ONLY(WARNING), 0, 0.0, start);
    return CALLED(ENTER, expected, c);
}

/* Read the time of a run. */
static void ask_time(Fuzz *f, Unit *u)
{
    if (u->phase & RUN)
        CALLED(fmi2GetRealStatus, ONLY(OK), u->handle, fmi2LastSuccessfulTime, &u->time);
}

static int stepped(Fuzz *f, void *c, int expected, double point, double h)
{
    return CALLED(fmi2DoStep, of_step(unit_of(f, c), expected, point, h), c, point, h, (fmi2Boolean)below(f, 2));
}

/* Make calls that only FMI 2 has. */
static void others(Fuzz *f, Unit *u, int legal)
{
    const int run = legal && (u->phase & RUN), none = run ? ONLY(DISCARD) : ONLY(ERROR_);
    const fmi2StatusKind kind = (fmi2StatusKind)below(f, 5);
    fmi2Status status;
    double real = NAN;
    int whole = 9;
    const char *text = "";
    switch (below(f, 7)) {
    case 0:
        CALLED(fmi2CancelStep, ONLY(ERROR_), u->handle);
        break;
    case 1:
        CALLED(fmi2GetStatus, none, u->handle, kind, &status);
        break;
    case 2:
        if (!CALLED(fmi2GetRealStatus, run && kind == fmi2LastSuccessfulTime ? ONLY(OK) : none, u->handle, kind, &real)
            && real != u->time)
            wrong(f, "another time");
        break;
    case 3:
        CALLED(fmi2GetIntegerStatus, none, u->handle, kind, &whole);
        break;
    case 4:
        CALLED(fmi2GetBooleanStatus, run && kind == fmi2Terminated ? ONLY(OK) : none, u->handle, kind, &whole);
        break;
    case 5:
        CALLED(fmi2GetStringStatus, none, u->handle, kind, &text);
        break;
    default: {
        const unsigned reference = below(f, total + 2);
        const int orders[] = {(int)below(f, 4) - 1};
        const double values[] = {value_of(f)};
        const int input = reference - first_input < inputs;
        const int born = legal && u->phase != TERMINATED;
        if (strcmp(fmi2GetVersion(), "2.0") != 0 || strcmp(fmi2GetTypesPlatform(), "default") != 0)
            wrong(f, "another version");
        CALLED(fmi2SetRealInputDerivatives,
            !born || !input || orders[0] != 1 ? ONLY(ERROR_)
                : isfinite(values[0])         ? ONLY(OK)
                                              : ONLY(DISCARD),
            u->handle, &reference, 1, orders, values);
        CALLED(fmi2GetString, ONLY(ERROR_), u->handle, &reference, 1, &text);
        CALLED(fmi2SetString, ONLY(ERROR_), u->handle, &reference, 1, &text);
    }
    }
}

#else

#include "fmi3Functions.h"

#define ENTER fmi3EnterInitializationMode
#define LEAVE fmi3ExitInitializationMode
#define TERMINATE fmi3Terminate
#define RESET fmi3Reset
#define FREE fmi3FreeInstance
#define SAVE fmi3GetFMUState
#define RESTORE fmi3SetFMUState
#define FORGET fmi3FreeFMUState
#define SIZE fmi3SerializedFMUStateSize
#define WRITE fmi3SerializeFMUState
#define READ fmi3DeserializeFMUState
#define DEBUG fmi3SetDebugLogging
#define OUTPUT_DERIVATIVES fmi3GetOutputDerivatives
#define DERIVATIVE fmi3GetDirectionalDerivative
#define BACK fmi3GetAdjointDerivative
#define GET_FLOATS fmi3GetFloat64
#define SET_FLOATS fmi3SetFloat64
#define GET_INTS fmi3GetInt32
#define SET_INTS fmi3SetInt32
#define GET_TRUTHS fmi3GetBoolean
#define SET_TRUTHS fmi3SetBoolean
#define SAME_COUNTS 0
typedef fmi3Boolean Truth;
typedef fmi3Byte Byte;

static void logged(fmi3InstanceEnvironment host, fmi3Status status, fmi3String category, fmi3String text)
{
    (void)host;
    (void)status;
    (void)category;
    checked_text(text);
}

/* Between internal steps a host may read, and nothing else. */
static void looked(fmi3InstanceEnvironment host, fmi3Float64 time, fmi3Boolean set, fmi3Boolean get,
    fmi3Boolean finished, fmi3Boolean can_return, fmi3Boolean *wanted, fmi3Float64 *until)
{
    Fuzz *f = host;
    Unit *u = NULL;
    const fmi3ValueReference reference = first_output;
    double value = 0.0;
    void *state = NULL;
    for (int k = 0; k < SLOTS; k++)
        if (f->units[k].phase < 0)
            u = f->units + k;
    if (!u || set || !get || !finished || !isfinite(time))
        wrong(f, "an intermediate update with wrong arguments");
    if (!u)
        return;
    f->inside = 1;
    switch (below(f, 8)) {
    case 0:
        CALLED(fmi3GetFloat64, ONLY(OK), u->handle, &reference, 1, &value, 1);
        break;
    case 1:
        CALLED(fmi3SetFloat64, ONLY(ERROR_), u->handle, &reference, 1, &value, 1);
        break;
    case 2:
        CALLED(fmi3DoStep, ONLY(ERROR_), u->handle, time, 0.01, 1, NULL, NULL, NULL, NULL);
        break;
    case 3:
        CALLED(fmi3Reset, ONLY(ERROR_), u->handle);
        break;
    case 4:
        CALLED(fmi3GetFMUState, ONLY(ERROR_), u->handle, &state);
        break;
    case 5:
        fmi3FreeInstance(u->handle);
        break;
    default:
        break;
    }
    f->inside = 0;
    *wanted = one_in(f, 10);
    if (one_in(f, 3))
        *until = nonsense(f);
    (void)can_return;
}

/* Call the functions of Model Exchange in any order, if the FMU has it; those of co-simulation are errors. */
static void exchanged(Fuzz *f)
{
    fmi3Instance c = fmi3InstantiateModelExchange("one", guid, resources, 0, 1, f, logged);
    fmi3Boolean a, b, d, e, g;
    size_t states = 0, indicators = 0;
    double x[64] = {0.0}, time = 0.0;
    if (!c)
        return;
    CALLED(fmi3GetNumberOfContinuousStates, ONLY(OK), c, &states);
    CALLED(fmi3GetNumberOfEventIndicators, ONLY(OK), c, &indicators);
    if (one_in(f, 4) || CALLED(fmi3EnterInitializationMode, ONLY(OK), c, 0, 0.0, 0.0, 0, 0.0) == OK)
        CALLED(fmi3ExitInitializationMode, ALL, c);
    for (int k = 0; k < 20 && states <= 64 && indicators <= 64; k++)
        switch (below(f, 10)) {
        case 0:
            CALLED(fmi3EnterEventMode, ALL, c);
            break;
        case 1:
            CALLED(fmi3UpdateDiscreteStates, ALL, c, &a, &b, &d, &e, &g, &time);
            break;
        case 2:
            CALLED(fmi3EnterContinuousTimeMode, ALL, c);
            break;
        case 3:
            CALLED(fmi3SetTime, ALL, c, one_in(f, 4) ? NAN : 0.1 * (double)below(f, 9));
            break;
        case 4:
            CALLED(fmi3GetContinuousStates, ALL, c, x, states);
            break;
        case 5:
            x[below(f, 64)] = one_in(f, 4) ? NAN : 0.1 * (double)below(f, 9);
            CALLED(fmi3SetContinuousStates, ALL, c, x, states + one_in(f, 4));
            break;
        case 6:
            CALLED(fmi3GetContinuousStateDerivatives, ALL, c, x, states);
            break;
        case 7:
            CALLED(fmi3GetEventIndicators, ALL, c, x, indicators);
            break;
        case 8:
            CALLED(fmi3CompletedIntegratorStep, ALL, c, one_in(f, 2), &a, &b);
            break;
        default:
            CALLED(fmi3DoStep, ONLY(ERROR_), c, 0.0, 0.1, one_in(f, 2), &a, &b, &d, &time);
        }
    fmi3FreeInstance(c);
}

static void *made(Fuzz *f, int bad)
{
    void *c;
    alarm(PATIENCE);
    if (bad == 3) {
        if (fmi3InstantiateScheduledExecution("one", guid, "", 0, 1, f, logged, NULL, NULL, NULL))
            wrong(f, "an instance of another kind");
        exchanged(f);
        return NULL;
    }
    c = fmi3InstantiateCoSimulation(bad == 1 ? NULL : bad == 2 ? "" : "one", bad == 4 ? "other" : bad == 5 ? NULL : guid,
        resources, fmi3False, one_in(f, 2), bad == 6, one_in(f, 2), NULL, 0, f, one_in(f, 8) ? NULL : logged,
        one_in(f, 2) ? looked : NULL);
    f->made++;
    return c;
}

#define BEGIN(EXPECTED, HAS_STOP, STOP) CALLED(ENTER, EXPECTED, c, has_tolerance != 0, tolerance, start, HAS_STOP, STOP)

static int begin(Fuzz *f, void *c, int expected, int has_tolerance, double tolerance, double start);

static int entered(Fuzz *f, void *c, int expected, double start)
{
    return begin(f, c, expected, 0, 0.0, start);
}

/* Read the time of a run. */
static void ask_time(Fuzz *f, Unit *u)
{
    if (u->phase & RUN)
        CALLED(fmi3GetFloat64, ONLY(OK), u->handle, &total, 1, &u->time, 1);
}

static int stepped(Fuzz *f, void *c, int expected, double point, double h)
{
    fmi3Boolean events = 9, terminate = 9, early = 9;
    fmi3Float64 reached = NAN;
    Unit *u = unit_of(f, c);
    const int may = of_step(u, expected, point, h);
    int phase, status;
    if (!u)
        return CALLED(fmi3DoStep, expected, c, point, h, 1, &events, &terminate, &early, &reached);
    phase = u->phase;
    u->phase = phase == STEPPING ? -1 : phase; /* marks it for `looked` */
    if (one_in(f, 8)) {
        status = CALLED(fmi3DoStep, may, c, point, h, one_in(f, 2), NULL, NULL, NULL, NULL);
        reached = NAN;
    } else {
        status = CALLED(fmi3DoStep, may, c, point, h, one_in(f, 2), &events, &terminate, &early, &reached);
        if (status < ERROR_ && (events || terminate))
            wrong(f, "a step with an event or an end");
        if (expected != ALL && status == OK && (early ? !(reached > u->time && reached < point + h) : reached != point + h))
            wrong(f, "the time reached");
        if (expected != ALL && status == DISCARD && (early || reached != u->time))
            wrong(f, "the time of a step that was not made");
    }
    u->phase = phase;
    return status;
}

#define TYPES(NAME) \
    CALLED(fmi3Get##NAME, nothing, c, &reference, count, (void *)room, count); \
    CALLED(fmi3Set##NAME, nothing, c, &reference, count, (void *)room, count)

/* Make calls for features that this FMU does not have. */
static void others(Fuzz *f, Unit *u, int legal)
{
    static const size_t sizes[1];
    void *c = u->handle;
    const fmi3ValueReference reference = below(f, total + 2);
    const size_t count = below(f, 2);
    const int nothing = count || !legal ? ONLY(ERROR_) : ONLY(OK);
    const double seed = 1.0;
    double real = 0.0;
    size_t number = 0, element = 0;
    fmi3ValueReference other = 0;
    fmi3DependencyKind kind;
    fmi3Boolean a, b, d, e, g;
    fmi3IntervalQualifier qualifier;
    fmi3UInt64 counter = 0, resolution = 1;
    fmi3Int64 item = (fmi3Int64)next(f);
    unsigned char room[32] = {0};
    switch (below(f, 8)) {
    case 0:
        TYPES(Float32);
        TYPES(Int8);
        TYPES(UInt8);
        TYPES(Int16);
        break;
    case 1:
        TYPES(UInt16);
        TYPES(UInt32);
        TYPES(UInt64);
        TYPES(String);
        break;
    case 2:
        CALLED(fmi3GetBinary, nothing, c, &reference, count, &number, (void *)room, count);
        CALLED(fmi3SetBinary, nothing, c, &reference, count, sizes, (void *)room, count);
        CALLED(fmi3GetClock, nothing, c, &reference, count, &a);
        CALLED(fmi3SetClock, nothing, c, &reference, count, &a);
        break;
    case 3:
        CALLED(fmi3GetIntervalDecimal, nothing, c, &reference, count, &real, &qualifier);
        CALLED(fmi3GetIntervalFraction, nothing, c, &reference, count, &counter, &resolution, &qualifier);
        CALLED(fmi3GetShiftDecimal, nothing, c, &reference, count, &real);
        CALLED(fmi3GetShiftFraction, nothing, c, &reference, count, &counter, &resolution);
        CALLED(fmi3SetIntervalDecimal, nothing, c, &reference, count, &seed);
        CALLED(fmi3SetIntervalFraction, nothing, c, &reference, count, &counter, &resolution);
        CALLED(fmi3SetShiftDecimal, nothing, c, &reference, count, &seed);
        CALLED(fmi3SetShiftFraction, nothing, c, &reference, count, &counter, &resolution);
        break;
    case 4:
        CALLED(fmi3EnterEventMode, ONLY(ERROR_), c);
        CALLED(fmi3EnterStepMode, ONLY(ERROR_), c);
        CALLED(fmi3EnterConfigurationMode, ONLY(ERROR_), c);
        CALLED(fmi3ExitConfigurationMode, ONLY(ERROR_), c);
        CALLED(fmi3EnterContinuousTimeMode, ONLY(ERROR_), c);
        CALLED(fmi3EvaluateDiscreteStates, ONLY(ERROR_), c);
        break;
    case 5:
        CALLED(fmi3GetNumberOfVariableDependencies, ONLY(ERROR_), c, reference, &number);
        CALLED(fmi3GetVariableDependencies, ONLY(ERROR_), c, reference, &number, &other, &element, &kind, 1);
        CALLED(fmi3UpdateDiscreteStates, ONLY(ERROR_), c, &a, &b, &d, &e, &g, &real);
        CALLED(fmi3CompletedIntegratorStep, ONLY(ERROR_), c, 1, &a, &b);
        CALLED(fmi3SetTime, ONLY(ERROR_), c, real);
        CALLED(fmi3ActivateModelPartition, ONLY(ERROR_), c, reference, real);
        break;
    case 6:
        CALLED(fmi3SetContinuousStates, ONLY(ERROR_), c, &seed, 1);
        CALLED(fmi3GetContinuousStates, ONLY(ERROR_), c, &real, 1);
        CALLED(fmi3GetContinuousStateDerivatives, ONLY(ERROR_), c, &real, 1);
        CALLED(fmi3GetEventIndicators, ONLY(ERROR_), c, &real, 1);
        CALLED(fmi3GetNominalsOfContinuousStates, ONLY(ERROR_), c, &real, 1);
        CALLED(fmi3GetNumberOfEventIndicators, ONLY(ERROR_), c, &number);
        CALLED(fmi3GetNumberOfContinuousStates, ONLY(ERROR_), c, &number);
        break;
    default:
        CALLED(fmi3GetInt64, ONLY(OK) | ONLY(ERROR_), c, &reference, 1, &item, 1);
        item = one_in(f, 2) ? (fmi3Int64)below(f, 4) : (fmi3Int64)next(f);
        CALLED(fmi3SetInt64, ONLY(OK) | ONLY(DISCARD) | ONLY(ERROR_), c, &reference, 1, &item, 1);
        if (strcmp(fmi3GetVersion(), "3.0") != 0)
            wrong(f, "another version");
    }
}

#endif

/* What may be expected --------------------------------------------------------------------------------------------- */

static int expect(int legal)
{
    return legal ? ONLY(OK) : ONLY(ERROR_);
}

/* Read all Real outputs; return the status. */
static int all_outputs(Fuzz *f, Unit *u, double *values)
{
    unsigned *references = malloc((outputs + 1) * sizeof *references);
    int status;
    for (unsigned k = 0; k < outputs; k++)
        references[k] = first_output + k;
    status = CALLED(GET_FLOATS, ONLY(OK) | ONLY(DISCARD) | ONLY(ERROR_), u->handle, references, outputs, values, outputs);
    for (unsigned k = 0; status == OK && k < outputs; k++)
        if (!isfinite(values[k]))
            wrong(f, "an output that is not finite, and OK");
    free(references);
    return status;
}

/* Operations ------------------------------------------------------------------------------------------------------- */

static void begin_again(Fuzz *f, Unit *u)
{
    const int bad = one_in(f, 10) ? 1 + (int)below(f, FUZZ_FMI == 2 ? 5 : 6) : 0;
    if (u->handle)
        FREE(u->handle);
    u->handle = made(f, bad);
    u->stop = INFINITY;
    if (!u->handle != (bad != 0))
        wrong(f, "an instance is missing, or unexpected");
    u->phase = u->handle ? BORN : NONE;
    u->time = 0.0;
}

/* Begin an experiment with or without a stop time; one before the start is refused. */
static int begin(Fuzz *f, void *c, int expected, int has_tolerance, double tolerance, double start)
{
    const int has_stop = one_in(f, 2);
    const double stop = one_in(f, 2) ? nonsense(f) : start + unit(f);
    Unit *u = unit_of(f, c);
    const int status = BEGIN(has_stop && !(stop >= start) ? ONLY(ERROR_) : expected, has_stop, stop);
    if (u && status <= WARNING)
        u->stop = has_stop ? stop : INFINITY;
    return status;
}

/* Enter the next phase, or another one. */
static void live(Fuzz *f, Unit *u, int legal)
{
    const int phase = legal ? u->phase : NONE;
    const unsigned way = one_in(f, 6) ? below(f, 6) : phase == BORN ? 0 : phase == INITIALIZING ? 1 : 2;
    const double start = one_in(f, 6) ? nonsense(f) : 0.0;
    int status;
    switch (way) {
    case 0:
        status = entered(f, u->handle, phase != BORN ? ONLY(ERROR_) : ONLY(OK) | (isfinite(start) ? 0 : ONLY(ERROR_)), start);
        if (status == OK && legal) {
            u->phase = INITIALIZING;
            u->time = NAN; /* FMI 2 may have set another one */
        }
        break;
    case 1:
        status = CALLED(LEAVE, phase == INITIALIZING ? ONLY(OK) | ONLY(ERROR_) : ONLY(ERROR_), u->handle);
        if (status == OK) {
            u->phase = STEPPING;
            ask_time(f, u);
        }
        break;
    case 2:
        if (phase == STEPPING && !one_in(f, 40))
            break;
        if (CALLED(TERMINATE, expect(phase == STEPPING), u->handle) == OK)
            u->phase = TERMINATED;
        break;
    case 3:
        if (!one_in(f, 4))
            break;
        if (CALLED(RESET, expect(legal), u->handle) == OK) {
            u->phase = BORN;
            u->time = 0.0;
            u->stop = INFINITY;
        }
        break;
    case 4: {
        const double tolerance = nonsense(f);
        const int has = one_in(f, 2);
        status = begin(f, u->handle,
            phase != BORN ? ONLY(ERROR_) : ONLY(OK) | (has ? ONLY(WARNING) : 0) | (isfinite(start) ? 0 : ONLY(ERROR_)),
            has, tolerance, start);
        if (status <= WARNING) {
            u->phase = FUZZ_FMI == 3 ? INITIALIZING : BORN;
            u->time = NAN;
        }
        break;
    }
    default: {
        const char *categories[] = {"logAll", "logStatusError", one_in(f, 4) ? "nothing" : "logStatusDiscard"};
        const size_t count = below(f, 4);
        const int known = count < 3 || strcmp(categories[2], "nothing") != 0;
        CALLED(DEBUG, expect(legal && known), u->handle, one_in(f, 2), count, categories);
    }
    }
}

/* Get and set values of any type, by valid and invalid references. */
static void values(Fuzz *f, Unit *u, int legal)
{
    unsigned references[MOST_VALUES];
    double reals[MOST_VALUES];
    int wholes[MOST_VALUES];
    Truth truths[MOST_VALUES];
    const unsigned count = below(f, MOST_VALUES + 1);
    const int bad_arrays = one_in(f, 30) && count;
    /* FMI 3 gives start values as soon as there is an instance. */
    const int begun = INITIALIZING | RUN | (FUZZ_FMI == 3 ? BORN : 0), readable = legal && (u->phase & begun);
    const size_t other_count = SAME_COUNTS || !one_in(f, 30) ? count : count + 1;
    const unsigned from = one_in(f, 3) ? 0 : one_in(f, 2) ? first_input : first_output;
    const unsigned most = from == first_input ? inputs : from == first_output ? outputs : total + 2;
    const int real = from != 0 || !most, good = !bad_arrays && other_count == count;
    void *room[] = {reals, wholes, truths};
    for (unsigned k = 0; k < count; k++) {
        references[k] = one_in(f, 200) ? (unsigned)next(f) : from + below(f, most ? most : total);
        reals[k] = value_of(f);
        wholes[k] = one_in(f, 3) ? (int)next(f) : (int)below(f, 4);
        truths[k] = (Truth)below(f, 2);
    }
    if (bad_arrays)
        room[0] = room[1] = room[2] = NULL;
    switch (real ? below(f, 2) : below(f, 6)) {
    case 0: {
        const int expected = !readable || !good ? ONLY(ERROR_) : ONLY(OK) | ONLY(DISCARD) | ONLY(ERROR_);
        if (CALLED(GET_FLOATS, count ? expected : readable && good ? ONLY(OK) : ONLY(ERROR_), u->handle, references,
                count, room[0], other_count)
            == OK)
            for (unsigned k = 0; k < count; k++)
                if (!isfinite(reals[k]))
                    wrong(f, "a value that is not finite, and OK");
        break;
    }
    case 1: {
        const int born = legal && (u->phase & (BORN | INITIALIZING | STEPPING)) && good;
        const int status = CALLED(SET_FLOATS, !born ? ONLY(ERROR_) : ONLY(OK) | ONLY(DISCARD) | ONLY(ERROR_), u->handle,
            references, count, room[0], other_count);
        if (status <= DISCARD && u->phase == STEPPING)
            for (unsigned k = 0; k < count; k++)
                if (references[k] - first_input >= inputs)
                    wrong(f, "a variable that is no input was set in a run");
        if (status == OK)
            for (unsigned k = 0; k < count; k++)
                if (!isfinite(reals[k]))
                    wrong(f, "a number that is not finite was accepted");
        break;
    }
    case 2:
        CALLED(GET_INTS, readable && good ? ONLY(OK) | ONLY(DISCARD) | ONLY(ERROR_) : ONLY(ERROR_), u->handle, references,
            count, room[1], other_count);
        break;
    case 3:
        CALLED(SET_INTS, ONLY(OK) | ONLY(DISCARD) | ONLY(ERROR_), u->handle, references, count, room[1], other_count);
        break;
    case 4:
        CALLED(GET_TRUTHS, readable && good ? ONLY(OK) | ONLY(DISCARD) | ONLY(ERROR_) : ONLY(ERROR_), u->handle,
            references, count, room[2], other_count);
        break;
    default:
        CALLED(SET_TRUTHS, ONLY(OK) | ONLY(DISCARD) | ONLY(ERROR_), u->handle, references, count, room[2], other_count);
    }
}

/* Make a step, which either ends with finite outputs or changes nothing. */
static void step(Fuzz *f, Unit *u, int legal)
{
    const int can = legal && u->phase == STEPPING, sane = !one_in(f, 5) && isfinite(u->time);
    const double point = sane || one_in(f, 2) ? u->time : nonsense(f);
    const double h = sane ? 0.001 + 0.05 * unit(f) * unit(f) : nonsense(f);
    const int watch = can && one_in(f, 3);
    double *before = malloc((outputs + 1) * sizeof *before), *after = malloc((outputs + 1) * sizeof *after);
    const int known = watch ? all_outputs(f, u, before) : ERROR_;
    const int status = stepped(f, u->handle, can ? ONLY(OK) | ONLY(DISCARD) : ONLY(ERROR_), point, h);
    if (can && status == OK && !(isfinite(point) && isfinite(h) && h > 0.0))
        wrong(f, "an invalid step was made");
    if (status == OK) {
        f->steps++;
        if (all_outputs(f, u, after) != OK)
            wrong(f, "outputs after a step");
        u->time = point + h;
        if (FUZZ_FMI == 3)
            ask_time(f, u); /* It may have returned early. */
    } else if (known == OK) {
        if (all_outputs(f, u, after) != OK || memcmp(before, after, outputs * sizeof *after) != 0)
            wrong(f, "a step that was not made changed outputs");
    }
    free(before);
    free(after);
}

static void derivatives(Fuzz *f, Unit *u, int legal)
{
    const int run = legal && (u->phase & RUN);
    const int any = ONLY(OK) | ONLY(DISCARD) | ONLY(ERROR_);
    unsigned unknowns[2], knowns[2];
    double directions[2], changes[2] = {0.0, 0.0};
    int orders[2];
    for (int k = 0; k < 2; k++) {
        unknowns[k] = one_in(f, 20) ? below(f, total + 3) : first_output + below(f, outputs);
        knowns[k] = one_in(f, 20) || !inputs ? below(f, total + 3) : first_input + below(f, inputs);
        directions[k] = value_of(f);
        orders[k] = one_in(f, 20) ? (int)below(f, 9) - 3 : 1 + (int)below(f, 2);
    }
    if (one_in(f, 2)) {
        if (CALLED(DERIVATIVE, legal && u->phase & (INITIALIZING | RUN) ? any : ONLY(ERROR_), u->handle, unknowns, 2,
                knowns, 2, directions, 2, changes, 2)
                == OK
            && !(isfinite(changes[0]) && isfinite(changes[1])))
            wrong(f, "a derivative that is not finite, and OK");
#ifdef BACK
        if (CALLED(BACK, legal && u->phase & (INITIALIZING | RUN) ? any : ONLY(ERROR_), u->handle, unknowns, 2, knowns, 2,
                directions, 2, changes, 2)
                == OK
            && !(isfinite(changes[0]) && isfinite(changes[1])))
            wrong(f, "an adjoint derivative that is not finite, and OK");
#endif
        return;
    }
    if (CALLED(OUTPUT_DERIVATIVES, run ? any : ONLY(ERROR_), u->handle, unknowns, 2, orders, changes, 2) == OK
        && !(isfinite(changes[0]) && isfinite(changes[1])))
        wrong(f, "a derivative that is not finite, and OK");
}

/* Return the check sum of bytes, as in zip archives. */
static uint32_t crc32(const unsigned char *bytes, size_t size)
{
    uint32_t sum = ~0u;
    for (size_t k = 0; k < size; k++) {
        sum ^= bytes[k];
        for (int bit = 0; bit < 8; bit++)
            sum = sum >> 1 ^ (sum & 1 ? 0xedb88320u : 0);
    }
    return ~sum;
}

/* Save, restore, write, change and read states, and pass unknown ones. */
static void states(Fuzz *f, Unit *u, int legal)
{
    static uint64_t nobody[64];
    const unsigned k = below(f, SLOTS);
    const int there = legal && f->states[k];
    size_t size = 0;
    switch (below(f, 7)) {
    case 0:
        if (CALLED(SAVE, expect(legal), u->handle, &f->states[k]) == OK)
            f->state_phase[k] = u->phase;
        break;
    case 1:
        if (CALLED(RESTORE, there ? ONLY(OK) | (f->state_phase[k] < 0 ? ONLY(ERROR_) : 0) : ONLY(ERROR_), u->handle,
                f->states[k])
            == OK) {
            if (f->state_phase[k] < 0) { /* Any status may follow; the sanitizers judge. */
                double *y = malloc((outputs + 1) * sizeof *y);
                u->phase = STEPPING;
                for (int times = 0; times < 3; times++) {
                    stepped(f, u->handle, ALL, times * 0.01, 0.01);
                    all_outputs(f, u, y);
                }
                free(y);
                begin_again(f, u);
                break;
            }
            u->phase = f->state_phase[k];
            ask_time(f, u);
        }
        break;
    case 2: {
        void *foreign = nobody;
        CALLED(RESTORE, ONLY(ERROR_), u->handle, foreign);
        CALLED(FORGET, ONLY(ERROR_), u->handle, &foreign);
        CALLED(SIZE, ONLY(ERROR_), u->handle, foreign, &size);
        CALLED(SAVE, ONLY(ERROR_), u->handle, NULL);
        break;
    }
    case 3:
        if (CALLED(SIZE, expect(there), u->handle, f->states[k], &size) != OK)
            break;
        free(f->bytes[k]);
        f->bytes[k] = malloc(size);
        f->sizes[k] = size;
        f->bytes_phase[k] = f->state_phase[k];
        CALLED(WRITE, ONLY(ERROR_), u->handle, f->states[k], (Byte *)f->bytes[k], size - 1 - below(f, 20));
        CALLED(WRITE, ONLY(OK), u->handle, f->states[k], (Byte *)f->bytes[k], size);
        break;
    case 4: {
        const unsigned from = below(f, SLOTS);
        const int readable = legal && f->bytes[from];
        int changed = 0;
        unsigned char *copy;
        void *read = NULL;
        if (!f->bytes[from])
            break;
        size = f->sizes[from];
        copy = malloc(size);
        memcpy(copy, f->bytes[from], size);
        if (one_in(f, 2)) {
            nonsense_bytes(f, copy, size);
            changed = memcmp(copy, f->bytes[from], size) != 0;
        }
        CALLED(READ, expect(readable && !changed), u->handle, (const Byte *)copy, size, &read);
        if (read && !f->states[k]) {
            f->states[k] = read;
            f->state_phase[k] = f->bytes_phase[from];
            read = NULL;
        }
        if (read)
            CALLED(FORGET, ONLY(OK), u->handle, &read);
        CALLED(READ, ONLY(ERROR_), u->handle, (const Byte *)copy, size / 2, &read);
        free(copy);
        break;
    }
    case 5: { /* Change a number, and correct the check sum. */
        const unsigned from = below(f, SLOTS);
        uint32_t sum = 0;
        double number = nonsense(f);
        unsigned char *copy;
        if (!f->bytes[from] || !legal || f->states[k])
            break;
        size = f->sizes[from];
        copy = malloc(size);
        memcpy(copy, f->bytes[from], size);
        memcpy(copy + 8 * (2 + next(f) % (size / 8 - 2)), &number, sizeof number);
        memcpy(copy + 8, &sum, sizeof sum);
        sum = crc32(copy, size);
        memcpy(copy + 8, &sum, sizeof sum);
        if (CALLED(READ, ONLY(OK) | ONLY(ERROR_), u->handle, (const Byte *)copy, size, &f->states[k]) == OK)
            f->state_phase[k] = -1;
        free(copy);
        break;
    }
    default:
        CALLED(FORGET, expect(legal), u->handle, &f->states[k]);
    }
}

static void *fuzzed(void *given)
{
    static uint64_t nobody[64];
    Fuzz *f = given;
    Unit stranger = {NULL, NONE, 0.0, INFINITY};
    while (f->made < f->calls && f->failures < 20) {
        Unit *u = f->units + below(f, SLOTS);
        int legal;
        if (one_in(f, 50)) { /* no handle, or an invalid one */
            u = &stranger;
            u->handle = one_in(f, 2) ? NULL : (void *)nobody;
        }
        if (u != &stranger && (!u->handle || one_in(f, 400)))
            begin_again(f, u);
        legal = u != &stranger && u->handle;
        if (!legal && u != &stranger)
            continue;
        switch (below(f, 16)) {
        case 0:
        case 1:
            live(f, u, legal);
            break;
        case 2:
        case 3:
        case 4:
            values(f, u, legal);
            break;
        case 5:
            derivatives(f, u, legal);
            break;
        case 6:
        case 7:
            states(f, u, legal);
            break;
        case 8:
            others(f, u, legal);
            break;
        default:
            if (legal && u->phase < STEPPING)
                live(f, u, legal);
            else
                step(f, u, legal);
        }
    }
    stranger.handle = made(f, 0);
    for (int k = 0; k < SLOTS; k++) {
        FORGET(stranger.handle, &f->states[k]);
        free(f->bytes[k]);
        FREE(f->units[k].handle);
    }
    FREE(stranger.handle);
    return NULL;
}

int main(int count, char **argv)
{
    enum { THREADS = 8 };
    static Fuzz fuzzes[THREADS];
    static pthread_t threads[THREADS];
    long calls = 0, steps = 0, counts[STATUSES] = {0};
    int failures = 0, number, slowest = 0;
    if (count != 10)
        return 2;
    if (strlen(argv[0]) >= LONGEST_PATH || !strrchr(argv[0], '.'))
        return 2;
    snprintf(resources, sizeof resources, "%s%.*s/resources/", FUZZ_FMI == 2 ? "file://" : "",
        (int)(strrchr(argv[0], '.') - argv[0]), argv[0]);
    guid = argv[1];
    number = atoi(argv[4]);
    total = (unsigned)atoi(argv[5]);
    first_input = (unsigned)atoi(argv[6]);
    inputs = (unsigned)atoi(argv[7]);
    first_output = (unsigned)atoi(argv[8]);
    outputs = (unsigned)atoi(argv[9]);
    number = number < 1 ? 1 : number > THREADS ? THREADS : number;
    for (int k = 0; k < number; k++) {
        fuzzes[k].random = (uint64_t)atoll(argv[2]) * 0x9e3779b97f4a7c15u + (uint64_t)k + 1;
        fuzzes[k].calls = atol(argv[3]) / number;
        if (number == 1)
            fuzzed(&fuzzes[k]);
        else
            pthread_create(&threads[k], NULL, fuzzed, &fuzzes[k]);
    }
    for (int k = 0; k < number; k++) {
        if (number > 1)
            pthread_join(threads[k], NULL);
        calls += fuzzes[k].made;
        steps += fuzzes[k].steps;
        failures += fuzzes[k].failures;
        for (int status = 0; status < STATUSES; status++)
            counts[status] += fuzzes[k].counts[status];
        if (fuzzes[k].longest > fuzzes[slowest].longest)
            slowest = k;
    }
    printf("FMI %d, seed %s, %d thread(s): %ld calls, %ld steps made (%ld OK, %ld warnings, %ld discarded, %ld errors), "
           "longest %.3f s (%s), %d wrong\n",
        FUZZ_FMI, argv[2], number, calls, steps, counts[OK], counts[WARNING], counts[DISCARD], counts[ERROR_],
        fuzzes[slowest].longest, fuzzes[slowest].slowest, failures);
    return failures != 0;
}
