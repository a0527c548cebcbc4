/* Common part of FMI 2 and FMI 3: an instance behind a handle, its phase, its log, and the functions of both. The
   argument `call` is the name of the FMI function that the host called. */

#pragma once

#include "instance.h"
#include "scene.h"

#ifndef NO_MEMORY
#define NO_MEMORY "there is not enough memory"
#endif

/* Result of a call, with the numbers of fmi2Status and fmi3Status. */
typedef enum { STATUS_OK, STATUS_WARNING, STATUS_DISCARD, STATUS_ERROR } Status;

typedef enum { ALL, WARNING, DISCARD, ERROR_, FATAL, CATEGORIES } Category;

/* Types of the host's arrays, and the variables that have such values. */
typedef enum {
    AS_DOUBLE,  /* double: Real variables, and time in FMI 3 */
    AS_INT,    /* int: Integer variables */
    AS_FMI2_INTEGER, /* int: Integer variables and choices, as in FMI 2 */
    AS_INT64,   /* int64_t: choices, as in FMI 3 */
    AS_INT_BOOLEAN,   /* int: Boolean variables, as in FMI 2 */
    AS_BOOL,  /* bool: Boolean variables, as in FMI 3 */
    VALUE_TYPES
} Value_type;

/* Intermediate update: lets the host look after an internal step that ends at `time`. If the host wants to return
   early, `until` becomes the time from which it does. */
typedef void Look(void *host, double time, int can_return, double *until);

/* A saved state: the bytes of the instance follow. */
typedef struct {
    unsigned magic;
    size_t size;
    unsigned char bytes[];
} State;

typedef struct {
    unsigned magic;
    Scene *scene;
    Instance *instance;
    char *name;
    void (*log)(void *host, const char *name, Category category, const char *text);
    Look *look;
    void *host;
    State *before, *after; /* states around a step with intermediate updates */
    unsigned logged; /* categories that are logged, as bits */
    int has_time;    /* whether time is a variable, whose number follows those of the scene */
    int exchanges;   /* whether the instance is for Model Exchange */
    int refusals;    /* how often the last step was refused in succession */
    double point, length; /* that step */
} Component;

extern const char *const category_names[CATEGORIES];

int component_phase(const Component *c);

/* Return a new component with a zeroed host of `host` bytes; NULL, and the reason in `why`, if this fails. */
Component *component_new(
    const char *name, const char *guid, const char *resources, size_t host, char *why, size_t why_size);

void component_free(Component *c);
int component_good(const Component *c);
void component_say(Component *c, Category category, const char *text);
Status component_refuse(Component *c, Category category, const char *call, const char *why);
Status component_refused(Component *c, Status status);
Status component_warn(Component *c);
int component_begun(Component *c);
int component_in(Component *c, int phases, const char *call);
Status component_logging(Component *c, int on, size_t count, const char *const categories[], const char *call);

/* `tolerance` is 0 and `stop` is NULL if the host gives none. */
Status component_begin(Component *c, double start, const double *stop, double tolerance, const char *call);

Status component_enter(Component *c, const char *call);
Status component_initialized(Component *c, const char *call);
Status component_terminated(Component *c, const char *call);
Status component_reset(Component *c, const char *call);

/* `early` is NULL in FMI 2, which has no early return. */
Status component_step(Component *c, double point, double step, int *early, const char *call);

Status component_save(Component *c, void **state, const char *call);
Status component_restore(Component *c, void *state, const char *call);
Status component_forget(Component *c, void **state, const char *call);
Status component_state_size(Component *c, void *state, size_t *size, const char *call);
Status component_write(Component *c, void *state, void *bytes, size_t size, const char *call);
Status component_read(Component *c, const void *bytes, size_t size, void **state, const char *call);
