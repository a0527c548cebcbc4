#include "message.h"

#include <stdarg.h>
#include <stdio.h>

#include "instance.h"
#include "scene.h"
#include "text.h"

Outcome instance_say(Instance *i, Outcome outcome, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    write_list(i->text, sizeof i->text, format, arguments);
    va_end(arguments);
    return outcome;
}

/* Give the host a warning, once in a run. */
void instance_warn(Instance *i, int of, const char *format, ...)
{
    va_list arguments;
    size_t used;
    if (i->flags.warned & of)
        return;
    if (i->warns) /* Append it to an unread warning. */
        strncat(i->warning, "; ", sizeof i->warning - strlen(i->warning) - 1);
    else
        *i->warning = '\0';
    i->flags.warned |= of;
    i->warns = 1;
    used = strlen(i->warning);
    va_start(arguments, format);
    write_list(i->warning + used, sizeof i->warning - used, format, arguments);
    va_end(arguments);
}

const char *instance_row_label(const Instance *i, int row, char *label, size_t size)
{
    const Row *r = i->scene->rows + row;
    snprintf(label, size, *r->direction ? "%s %s" : "%s", r->name, r->direction);
    return label;
}
