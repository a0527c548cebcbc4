/* Times a native FMU from C, compiled with its sources: GUID is given when it is compiled, argv are steps, step [s],
   rounds and the URI of its resources. Prints for each round the time [s] of an instantiation with initialisation, of a
   doStep, and of what the kernel does in it: a step, and the outputs at its end. */

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "alfmu.c" /* whose functions are static */

/* Of this process alone, whatever else the machine does. */
static double now(void)
{
    return (double)clock() / CLOCKS_PER_SEC;
}

static fmi2Component begun(const char *resources)
{
    const fmi2CallbackFunctions functions = {NULL, NULL, NULL, NULL, NULL};
    fmi2Component c = fmi2Instantiate("one", fmi2CoSimulation, GUID, resources, &functions, fmi2False, fmi2False);
    if (!c || fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0) != fmi2OK
        || fmi2EnterInitializationMode(c) != fmi2OK || fmi2ExitInitializationMode(c) != fmi2OK)
        exit(1);
    return c;
}

int main(int count, char **argv)
{
    const int steps = count == 5 ? atoi(argv[1]) : 0, rounds = count == 5 ? atoi(argv[3]) : 0;
    const double h = count == 5 ? atof(argv[2]) : 0.0;
    for (int round = 0; round < rounds; round++) {
        double start = now(), ready, stepped;
        fmi2Component c = begun(argv[4]);
        Instance *i;
        ready = now() - start;
        start = now();
        for (int k = 0; k < steps; k++)
            if (fmi2DoStep(c, h * k, h, fmi2True) != fmi2OK)
                return 2;
        stepped = (now() - start) / steps;
        fmi2FreeInstance(c);
        c = begun(argv[4]);
        i = ((Component *)c)->instance;
        settings_upload_arguments(i);
        start = now();
        for (int k = 0; k < steps; k++)
            if (step_fixed(i, 1, h) != 1 || !outputs_read_quickly(i))
                return 3;
        printf("%.9g %.9g %.9g\n", ready, stepped, (now() - start) / steps);
        fmi2FreeInstance(c);
    }
    return 0;
}
