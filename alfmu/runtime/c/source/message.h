/* Plain C has no messages: they are neither written nor evaluated. */

#pragma once

#include "instance.h"

static int message_unsaid(const char *format, ...)
{
    return (void)format, 0;
}

static Outcome message_outcome(Outcome outcome)
{
    return outcome;
}

#define write_text(text, size, ...) ((void)(0 && message_unsaid(__VA_ARGS__)), (void)(size), (void)(*(text) = '\0'))
#define instance_row_label(i, row, label, size) ((void)(row), (void)(size), *(label) = '\0', (label))
#define instance_say(i, outcome, ...) (write_text((i)->text, 0, __VA_ARGS__), message_outcome(outcome))
#define instance_warn(i, of, ...) \
    (write_text((i)->warning, 0, __VA_ARGS__), (i)->warns = 1, (void)((i)->flags.warned |= (of)))
