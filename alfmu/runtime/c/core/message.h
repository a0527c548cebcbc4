/* Messages of an instance: the reason of a failure, and warnings that are given once in a run. */

#pragma once

#include "instance.h"
#include "text.h"

/* Set the message of an instance and return the outcome. */
Outcome instance_say(Instance *i, Outcome outcome, const char *format, ...) PRINTF_LIKE(3, 4);

void instance_warn(Instance *i, int of, const char *format, ...);
const char *instance_row_label(const Instance *i, int row, char *label, size_t size);
