/* What the layers of FMI 2 and FMI 3 share: an instance behind a handle, its phase of life, and what it logs. */

#ifndef ALFMU_COMPONENT_H
#define ALFMU_COMPONENT_H

#include "alfmu.h"

/* Phases of life, as bits, so that a call can name all in which it is legal. */
typedef enum {
    INSTANTIATED = 1,
    INITIALIZING = 2,
    STEPPING = 4,
    TERMINATED = 8,
    BORN = INSTANTIATED | INITIALIZING | STEPPING,
    KNOWN = INITIALIZING | STEPPING | TERMINATED,
    ANY = BORN | TERMINATED
} Phase;

/* What a call comes to, with the numbers of fmi2Status and fmi3Status. */
typedef enum { FINE, WARNED, DISCARDED, WRONG } Status;

typedef enum { ALL, WARNING, DISCARD, ERROR_, FATAL, CATEGORIES } Category;

typedef struct {
    unsigned magic;
    Phase phase;
    Scene *scene;
    Instance *instance;
    char *name;
    void (*log)(void *host, const char *name, Category category, const char *text);
    void *host;
    unsigned logged; /* categories, as bits */
} Component;

/* A saved state. */
typedef struct {
    unsigned magic;
    Phase phase;
    size_t size;
    unsigned char bytes[];
} State;

extern const char *const category_names[CATEGORIES];

/* NULL, and why, where there can be none. */
Component *component_new(const char *name, const char *guid, const char *resources, char *why, size_t why_size);
void component_free(Component *c);
int component_good(const Component *c);
int component_in(Component *c, int phases, const char *call);
void component_say(Component *c, Category category, const char *text);
void component_refuse(Component *c, Category category, const char *call, const char *why);
int component_logging(Component *c, int on, size_t count, const char *const categories[]);
/* `tolerance` is 0 where the host asks for none. */
Status component_begin(Component *c, double start, double tolerance, const char *call);
Status component_initialized(Component *c, const char *call);
Status component_terminated(Component *c, const char *call);
Status component_reset(Component *c, const char *call);

/* Whether the arrays can be looked at and hold references of variables of a type; outputs are then known. */
Status component_readable(
    Component *c, const unsigned *references, size_t count, const void *values, Type type, const char *call);
/* The same for values that are to be set. */
Status component_writable(
    Component *c, const unsigned *references, size_t count, const void *values, Type type, const char *call);
/* The worse of a status and of what setting a value came to. */
Status component_set(Component *c, Status status, Outcome outcome);
Status component_derivative(Component *c, const unsigned *unknowns, size_t unknown_count, const unsigned *knowns,
    size_t known_count, const double *directions, double *changes, const char *call);
Status component_step(Component *c, double point, double step);

State *state_of(Component *c, State *state, const char *call);
int state_known(Component *c, const State *state, const char *call);

int state_apply(Component *c, const State *state);
size_t serialized_size(const State *state);
void serialize(const State *state, unsigned char *bytes);
State *deserialized(Component *c, const unsigned char *bytes, size_t size);

#endif
