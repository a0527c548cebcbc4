/* Functions besides those of FMI: scenes and instances for a binding such as library.py. */

#if !defined(__wasm__)
#include <time.h>
#endif

#include "balance.h"
#include "begin.h"
#include "border.h"
#include "fmi.h"
#include "instance.h"
#include "layout.h"
#include "lanes.h"
#include "lifetime.h"
#include "message.h"
#include "outputs.h"
#include "rank.h"
#include "run.h"
#include "scene.h"
#include "scene_sizes.h"
#include "settings.h"
#include "state.h"
#include "topology.h"
#include "variables.h"
#include "way.h"
#include "whole_run.h"

#if !defined(__wasm__)
#endif

API int alfmu_scene_version(void)
{
    return SCENE_VERSION;
}

API Scene *alfmu_scene_load(const unsigned char *bytes, size_t size, char *why, size_t why_size)
{
    INSIDE(Scene *, scene_load(bytes, size, why, why_size));
}

/* Replace interpreted functions by compiled ones, or by ones in lanes; return zero if these belong to another scene. */
API int alfmu_scene_compiled(
    Scene *s, Compiled *const *functions, int count, int spare, const char *identity, int in_lanes)
{
    return scene_compiled(s, functions, count, spare, identity, in_lanes);
}

/* Return the flags with which functions are compiled in lanes for this processor; empty if it cannot be. */
API const char *alfmu_lane_flags(void)
{
#if !defined(__GNUC__)
    return "";
#else
#if PART == 4
    if (lanes_compiled() == LANES)
        return "-DLANES=8 -mavx512f";
    if (__builtin_cpu_supports("avx2"))
        return "-DLANES=4 -mavx2";
#endif
    return "-DLANES=4";
#endif
}

API void alfmu_scene_free(Scene *s)
{
    scene_free(s);
}

API Instance *alfmu_new(const Scene *s)
{
    return instance_new(s);
}

API size_t alfmu_length(const Scene *s, int starts)
{
    return instance_length(s, starts);
}

API void alfmu_free(Instance *i)
{
    instance_free(i);
}

API void alfmu_reset(Instance *i)
{
    instance_reset(i);
}

API const char *alfmu_text(const Instance *i)
{
    return i->text;
}

/* Return the flag of an unread warning, which its reader sets to 0. */
API int *alfmu_warns(Instance *i)
{
    return &i->warns;
}

API const char *alfmu_warning(const Instance *i)
{
    return i->warning;
}

/* Update and return the energy error of a communication step that the caller made. */
API double alfmu_balance(Instance *i)
{
    arena_reset(i);
    instance_balance(i);
    return i->counts[STEP_ERROR];
}

API const char *alfmu_name(const Scene *s)
{
    return s->name;
}

API int alfmu_variable_count(const Scene *s)
{
    return scene_variable_count(s);
}

API const char *alfmu_variable(const Scene *s, int reference, int *type, int *kind)
{
    *type = (int)s->variables[reference].type;
    *kind = (int)s->variables[reference].kind;
    return s->variables[reference].name;
}

API int alfmu_set(Instance *i, int reference, double value)
{
    INSIDE(int, instance_set(i, reference, value));
}

API int alfmu_choose(Instance *i, int reference, const char *value)
{
    const Scene *s = i->scene;
    const Choice *choice = s->choice + (reference - s->parameters);
    char known[300] = "";
    for (int k = 0; k < choice->count; k++) {
        if (!strcmp(value, choice->values[k]))
            return (int)instance_set(i, reference, k + 1);
        if (strlen(known) + strlen(choice->values[k]) + 3 < sizeof known) {
            strcat(known, *known ? ", " : "");
            strcat(known, choice->values[k]);
        }
    }
    return (int)instance_say(i, REFUSED,
        "%s: %s is '%.60s'; use one of %s, or make the scene with it (export with --set %s=%.60s)", s->name,
        s->variables[reference].name, value, known, s->variables[reference].name, value);
}

API const char *alfmu_chosen(const Instance *i, int reference)
{
    return i->scene->choice[reference - i->scene->parameters].values[(int)instance_get(i, reference) - 1];
}

API double alfmu_get(const Instance *i, int reference)
{
    return instance_get(i, reference);
}

API double alfmu_time(Instance *i)
{
    return *instance_time(i);
}

API void alfmu_set_time(Instance *i, double time)
{
    *instance_time(i) = time;
}

API int alfmu_tolerate(Instance *i, double tolerance)
{
    INSIDE(int, instance_tolerate(i, tolerance));
}

API int alfmu_begin(Instance *i, double start, double stop)
{
    INSIDE(int, instance_begin(i, start, stop));
}

/* Set the rate of an input in the next communication step; afterwards the input is constant. */
API int alfmu_slope(Instance *i, int reference, double value)
{
    INSIDE(int, instance_set_slope(i, reference, value));
}

/* Fix the parameters, or permit changes again. */
API void alfmu_run_on(Instance *i, int running)
{
    i->flags.phase = running ? STEPPING : INITIALIZING;
}

API int alfmu_initialized(const Instance *i)
{
    return i->flags.initialized;
}

API int alfmu_initialize(Instance *i)
{
    INSIDE(int, instance_initialize(i));
}

/* Begin a communication step, like `alfmu_step`, for a caller that makes the step itself. */
API int alfmu_ready(Instance *i, double start, double h)
{
    INSIDE(int, instance_ready(i, start, h));
}

/* Return the number of breaks in that step, and the times just before and just after each if there is room. */
API int alfmu_breaks(const Instance *i, double *times)
{
    if (times)
        memcpy(times, i->breaks, 2 * (size_t)i->broken * sizeof *times);
    return i->broken;
}

API int alfmu_step(Instance *i, double start, double h)
{
    INSIDE(int, instance_step(i, start, h));
}

/* Functions of Python's C interface, which the binding passes: the library is not linked with Python. */
typedef struct {
    double (*number)(void *object); /* PyFloat_AsDouble */
    void *(*address)(void *object); /* PyLong_AsVoidPtr */
    void *(*failed)(void);          /* PyErr_Occurred */
    void *(*release)(void);         /* PyEval_SaveThread */
    void (*acquire)(void *thread);  /* PyEval_RestoreThread */
    void *(*object)(long number);   /* PyLong_FromLong */
} Python;

static Python python;

/* `alfmu_step` as a Python function, in a tenth of the time of a ctypes call: self is the address of an instance, the
   arguments are start and length of the step; NULL means an exception. */
static void *step_from_python(void *self, void *const *arguments, ptrdiff_t count)
{
    const double start = count > 0 ? python.number(arguments[0]) : NAN,
                 h = count > 1 ? python.number(arguments[1]) : NAN;
    void *instance = python.address(self), *thread;
    int outcome;
    if (python.failed())
        return NULL;
    thread = python.release();
    outcome = alfmu_step(instance, start, h);
    python.acquire(thread);
    return python.object(outcome);
}

/* Python's description of a C function: PyMethodDef, with arguments as an array (METH_FASTCALL). */
typedef struct {
    const char *name;
    void *(*function)(void *self, void *const *arguments, ptrdiff_t count);
    int flags;
    const char *doc;
} Method;

/* Return the description of a Python function that steps; it must live as long as that function. */
API const Method *alfmu_python_step(const Python *functions)
{
    static const Method method = {"step", step_from_python, 0x80, NULL};
    python = *functions;
    return &method;
}

/* Get the outputs at this instant; if some cannot be computed, get the others. */
API int alfmu_read(Instance *i, double *values)
{
    const int first = scene_first_output(i->scene), end = scene_variable_count(i->scene);
    const Border border = border_in();
    const Outcome outcome = instance_read(i);
    for (int k = first; k < end; k++)
        values[k - first] = instance_get(i, k);
    border_out(&border);
    return (int)outcome;
}

API int alfmu_get_many(Instance *i, const int *references, int count, double *values)
{
    INSIDE(int, outputs_get_many(i, references, count, values));
}

API size_t alfmu_state_size(const Instance *i)
{
    return state_size(i);
}

API void alfmu_save(const Instance *i, unsigned char *state)
{
    state_save(i, state);
}

API int alfmu_restore(Instance *i, const unsigned char *state, size_t size)
{
    INSIDE(int, state_restore(i, state, size));
}

/* Return the address of q, v, computed angles, work and time, in this order; it is valid while the instance lives. */
API double *alfmu_state(Instance *i)
{
    return i->m + i->scene->z;
}

/* Set numbers without variables: zeta and omega of stabilised formulations, and whether steps end with projections
   (-1: the formulation decides). */
API int alfmu_stabilise(Instance *i, double zeta, double omega, int projection)
{
    return (int)instance_stabilise(i, zeta, omega, projection);
}

API int alfmu_mobility(Instance *i, int which, int *freedom, int *redundant, int *here, double *place)
{
    return (int)instance_mobility(i, (Counted_rows)which, freedom, redundant, here, place);
}

API void alfmu_update_way(Instance *i)
{
    arena_reset(i);
    way_update(i);
}

/* Return whether redundant constraints would brake the motion from the start. */
API int alfmu_brakes(const Instance *i)
{
    return i->flags.brakes;
}

/* Set the penalties of all constraints; before initialisation, those of the start. */
API int alfmu_penalize(Instance *i, const double *penalties)
{
    const Scene *s = i->scene;
    Outcome outcome;
    for (int r = 0; r < s->l; r++)
        if (!(isfinite(penalties[r]) && penalties[r] >= 0.0))
            return (int)instance_say(i, REFUSED,
                "%s: solver.penalty of constraint %d is %g; it must be a finite number, 0 or above", s->name, r + 1,
                penalties[r]);
    if (!i->flags.initialized) {
        memcpy(i->given, penalties, (size_t)s->l * sizeof *penalties);
        i->flags.given = 1;
        return DONE;
    }
    arena_reset(i);
    settings_upload_arguments(i);
    instance_remember(i);
    memcpy(i->full, penalties, (size_t)s->l * sizeof *penalties);
    i->flags.scaled = 0;
    outcome = topology_change(i, i->active);
    if (outcome != DONE)
        instance_go_back(i);
    arena_reset(i);
    return (int)outcome;
}

API void alfmu_penalties(const Instance *i, double *penalties)
{
    memcpy(penalties, i->penalty, (size_t)i->scene->l * sizeof *penalties);
}

API void alfmu_counts(const Instance *i, double *counts)
{
    memcpy(counts, i->counts, COUNTED * sizeof *counts);
    memcpy(counts + COUNTED, i->m + i->scene->tally, TALLY * sizeof *counts);
    counts[COUNTED + TALLY] = (double)i->shared;
}

#if !defined(__wasm__) /* WebAssembly has no C clock, and a web page runs step by step. */

/* A run in progress. */
typedef struct {
    const Run *run;
    long done; /* completed communication steps */
    clock_t asked;
} Going;

/* Ask the caller of a run, a few times a second, whether it goes on. */
static int goes_on(Instance *i)
{
    Going *going = i->run;
    int on = 1;
    if (clock() - going->asked > CLOCKS_PER_SEC / 20) {
        on = going->run->progress(going->done);
        going->asked = clock();
    }
    return on;
}

/* Make the run and return the number of rows. */
API long alfmu_run(Instance *i, const Run *r, int *outcome)
{
    const Border border = border_in();
    Going going = {r, 0, clock()};
    Outcome found;
    long rows;
    i->run = &going;
    i->go_on = r->progress ? goes_on : NULL;
    rows = whole_run_make(i, r, &going.done, &found);
    *outcome = i->ended ? -1 : (int)found;
    i->run = NULL;
    i->go_on = NULL;
    i->ended = 0;
    border_out(&border);
    return rows;
}

#endif
