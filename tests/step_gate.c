/* A host that calls an FMU of FMI 2 and ends where a step allocates, locks or calls the system: functions of the C
   library for that are counted, and the kernel ends the process at a system call. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <linux/seccomp.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

static int armed;

static void reach(const char *what)
{
    if (armed) {
        write(1, "a step calls ", 13);
        write(1, what, strlen(what));
        syscall(SYS_exit, 3);
    }
}

void *__libc_malloc(size_t size);
void *__libc_calloc(size_t count, size_t size);
void *__libc_realloc(void *memory, size_t size);
void __libc_free(void *memory);

void *malloc(size_t size)
{
    reach("malloc");
    return __libc_malloc(size);
}

void *calloc(size_t count, size_t size)
{
    reach("calloc");
    return __libc_calloc(count, size);
}

void *realloc(void *memory, size_t size)
{
    reach("realloc");
    return __libc_realloc(memory, size);
}

void free(void *memory)
{
    reach("free");
    __libc_free(memory);
}

int pthread_mutex_lock(pthread_mutex_t *mutex)
{
    reach("pthread_mutex_lock");
    return ((int (*)(pthread_mutex_t *))dlsym(RTLD_NEXT, "pthread_mutex_lock"))(mutex);
}

FILE *fopen(const char *path, const char *mode)
{
    reach("fopen");
    return ((FILE * (*)(const char *, const char *)) dlsym(RTLD_NEXT, "fopen"))(path, mode);
}

typedef struct {
    void (*log)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *environment;
} Functions;

static void unlogged(void *host, const char *name, int status, const char *category, const char *text, ...)
{
    (void)host, (void)name, (void)status, (void)category;
    if (!armed)
        puts(text);
}

#define FIND(type, name, ...) type (*name)(__VA_ARGS__) = (type (*)(__VA_ARGS__))dlsym(library, "fmi2" #name)

/* The library, the GUID, the resources, the step, how many; then references of inputs, "b" before those of Booleans, and
   behind "o" those of outputs. In place of them "malloc" and "getpid" do what no step may do. */
int main(int count, char **given)
{
    const Functions functions = {unlogged, calloc, free, NULL, NULL};
    void *library = dlopen(given[1], RTLD_NOW), *c;
    const double step = atof(given[4]);
    const int steps = atoi(given[5]);
    double sum = 0.0;
    FIND(void *, Instantiate, const char *, int, const char *, const char *, const Functions *, int, int);
    FIND(int, SetupExperiment, void *, int, double, double, int, double);
    FIND(int, EnterInitializationMode, void *);
    FIND(int, ExitInitializationMode, void *);
    FIND(int, SetReal, void *, const unsigned *, size_t, const double *);
    FIND(int, SetBoolean, void *, const unsigned *, size_t, const int *);
    FIND(int, GetReal, void *, const unsigned *, size_t, double *);
    FIND(int, DoStep, void *, double, double, int);
    if (!library || !(c = Instantiate("gate", 1, given[2], given[3], &functions, 0, 1)))
        return 1;
    if (SetupExperiment(c, 0, 0.0, 0.0, 0, 0.0) || EnterInitializationMode(c) || ExitInitializationMode(c))
        return 2;
    fflush(stdout);
    prctl(PR_SET_SECCOMP, SECCOMP_MODE_STRICT);
    armed = 1;
    if (!strcmp(given[count - 1], "malloc"))
        sum += malloc(1) != NULL;
    if (!strcmp(given[count - 1], "getpid"))
        sum += (double)syscall(SYS_getpid);
    for (int k = 0; k < steps; k++) {
        int is_output = 0;
        for (int j = 6; j < count; j++) {
            const int is_boolean = given[j][0] == 'b', on = k > steps / 2 && k < steps * 3 / 4;
            const unsigned reference = (unsigned)strtoul(given[j] + is_boolean, NULL, 10);
            double value = 0.001 * k;
            if (given[j][0] == 'o')
                is_output = 1;
            else if (is_output && GetReal(c, &reference, 1, &value))
                reach("an error of an output");
            else if (is_boolean ? SetBoolean(c, &reference, 1, &on) : !is_output && SetReal(c, &reference, 1, &value))
                reach("an error of an input");
            sum += is_output ? value : 0.0;
        }
        if (DoStep(c, k * step, step, 1))
            reach("an error");
    }
    armed = 0;
    write(1, sum != 0.0 ? "good" : "zero", 4);
    syscall(SYS_exit, 0);
    return 0;
}
