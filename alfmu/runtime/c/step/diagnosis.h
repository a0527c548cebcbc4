/* Finds the reason why a step or an evaluation failed. */

#pragma once

#include "instance.h"

/* Cost of a patient step, whose loops stop on convergence, in quick steps. */
#define PATIENT_STEP 10

Outcome diagnose_convergence(Instance *i, const double *watch, double t);
Outcome diagnose_failure(Instance *i, const double *q, const double *v, double t, double pivot);
Outcome diagnose_ahead(Instance *i, double within);
Outcome diagnose_state(Instance *i, double start, double dt);
Outcome diagnose_length(Instance *i, double t);
Outcome diagnose_laws(Instance *i, double end);
Outcome diagnose_too_much(Instance *i);
Outcome diagnose_interrupted(Instance *i);
Outcome diagnose_derivatives(Instance *i);
