/* The functions of FMI 2.0 that fmpy looks for, which do nothing, whatever they are called with. */

#define NOTHING(NAME) \
    int NAME() \
    { \
        return 0; \
    }

const char *fmi2GetVersion(void)
{
    return "2.0";
}

const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

void *fmi2Instantiate()
{
    static int one;
    return &one;
}

void fmi2FreeInstance() {}

NOTHING(fmi2SetDebugLogging)
NOTHING(fmi2SetupExperiment)
NOTHING(fmi2EnterInitializationMode)
NOTHING(fmi2ExitInitializationMode)
NOTHING(fmi2Terminate)
NOTHING(fmi2Reset)
NOTHING(fmi2GetReal)
NOTHING(fmi2GetInteger)
NOTHING(fmi2GetBoolean)
NOTHING(fmi2GetString)
NOTHING(fmi2SetReal)
NOTHING(fmi2SetInteger)
NOTHING(fmi2SetBoolean)
NOTHING(fmi2SetString)
NOTHING(fmi2GetFMUstate)
NOTHING(fmi2SetFMUstate)
NOTHING(fmi2FreeFMUstate)
NOTHING(fmi2SerializedFMUstateSize)
NOTHING(fmi2SerializeFMUstate)
NOTHING(fmi2DeSerializeFMUstate)
NOTHING(fmi2GetDirectionalDerivative)
NOTHING(fmi2SetRealInputDerivatives)
NOTHING(fmi2GetRealOutputDerivatives)
NOTHING(fmi2DoStep)
NOTHING(fmi2CancelStep)
NOTHING(fmi2GetStatus)
NOTHING(fmi2GetRealStatus)
NOTHING(fmi2GetIntegerStatus)
NOTHING(fmi2GetBooleanStatus)
NOTHING(fmi2GetStringStatus)
