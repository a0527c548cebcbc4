/* Loads the library of a native FMU on Windows and runs it for a while: argv are the library, its GUID and a
   reference; prints the value there after each step. */

#include <stdio.h>
#include <stdlib.h>
#include <windows.h>

#include "fmi2Functions.h"

static void say(
    fmi2ComponentEnvironment host, fmi2String name, fmi2Status status, fmi2String category, fmi2String text, ...)
{
    (void)host;
    (void)name;
    (void)status;
    fprintf(stderr, "%s %s\n", category, text);
}

int main(int count, char **argv)
{
    HMODULE library = count == 4 ? LoadLibraryA(argv[1]) : NULL;
    fmi2InstantiateTYPE *make;
    fmi2EnterInitializationModeTYPE *enter, *leave;
    fmi2DoStepTYPE *step;
    fmi2GetRealTYPE *get;
    fmi2FreeInstanceTYPE *end;
    const fmi2CallbackFunctions functions = {say, calloc, free, NULL, NULL};
    fmi2ValueReference reference;
    fmi2Component c;
    if (!library)
        return 1;
    make = (fmi2InstantiateTYPE *)GetProcAddress(library, "fmi2Instantiate");
    enter = (fmi2EnterInitializationModeTYPE *)GetProcAddress(library, "fmi2EnterInitializationMode");
    leave = (fmi2ExitInitializationModeTYPE *)GetProcAddress(library, "fmi2ExitInitializationMode");
    step = (fmi2DoStepTYPE *)GetProcAddress(library, "fmi2DoStep");
    get = (fmi2GetRealTYPE *)GetProcAddress(library, "fmi2GetReal");
    end = (fmi2FreeInstanceTYPE *)GetProcAddress(library, "fmi2FreeInstance");
    c = make("one", fmi2CoSimulation, argv[2], "", &functions, fmi2False, fmi2False);
    if (!c || enter(c) != fmi2OK || leave(c) != fmi2OK)
        return 2;
    reference = (fmi2ValueReference)atoi(argv[3]);
    for (int k = 0; k < 100; k++) {
        double value;
        if (step(c, 0.02 * k, 0.02, fmi2True) != fmi2OK || get(c, &reference, 1, &value) != fmi2OK)
            return 3;
        printf("%.17g\n", value);
    }
    end(c);
    return 0;
}
