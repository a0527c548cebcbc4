/* Messages without stdio. */

#ifndef ALFMU_MESSAGE_H
#define ALFMU_MESSAGE_H

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include "instance.h"

#if MESSAGE > 8

typedef struct {
    char *to;
    size_t left;
} Written;

static void put(Written *w, char c)
{
    if (w->left > 1) {
        *w->to++ = c;
        w->left--;
    }
}

static void put_whole(Written *w, long value)
{
    char digits[24];
    int count = 0;
    unsigned long size = value < 0 ? 0ul - (unsigned long)value : (unsigned long)value;
    if (value < 0)
        put(w, '-');
    do
        digits[count++] = (char)('0' + size % 10);
    while (size /= 10);
    while (count)
        put(w, digits[--count]);
}

/* A number with six digits at most. */
static void put_number(Written *w, double value)
{
    int tens = 0;
    long digits, unit = 100000;
    if (value < 0.0)
        put(w, '-');
    value = fabs(value);
    if (!(value <= DBL_MAX)) {
        for (const char *c = value > 0.0 ? "inf" : "nan"; *c; c++)
            put(w, *c);
        return;
    }
    for (; value >= 10.0; tens++)
        value /= 10.0;
    for (; value > 0.0 && value < 1.0; tens--)
        value *= 10.0;
    digits = (long)(value * 1e5 + 0.5);
    if (digits == 10 * unit) {
        digits = unit;
        tens++;
    }
    for (int place = tens >= 0 && tens < 6 ? tens : 0; digits || place >= 0; place--, unit /= 10) {
        put(w, (char)('0' + digits / unit));
        digits %= unit;
        if (place == 0 && digits)
            put(w, '.');
    }
    if (tens < 0 || tens >= 6) {
        put(w, 'e');
        put_whole(w, tens);
    }
}

/* As snprintf, with numbers of six digits. */
static void message_write(char *to, size_t size, const char *format, ...)
{
    Written w;
    va_list arguments;
    w.to = to;
    w.left = size;
    va_start(arguments, format);
    for (; *format; format++) {
        size_t most = (size_t)-1;
        const char *text;
        if (*format != '%') {
            put(&w, *format);
            continue;
        }
        format += 1;
        if (*format == '.')
            for (most = 0, format++; *format >= '0' && *format <= '9'; format++)
                most = 10 * most + (size_t)(*format - '0');
        switch (*format) {
        case 's':
            for (text = va_arg(arguments, const char *); *text && most; most--)
                put(&w, *text++);
            break;
        case 'd':
            put_whole(&w, va_arg(arguments, int));
            break;
        default:
            put_number(&w, va_arg(arguments, double));
        }
    }
    va_end(arguments);
    *w.to = '\0';
}

static const char *instance_row_label(const Instance *i, int row, char *label, size_t size)
{
    const Row *r = i->scene->rows + row;
    message_write(label, size, *r->direction ? "%s %s" : "%s", r->name, r->direction);
    return label;
}

#define write_text message_write
#else

/* What a message would say is not evaluated. */
static int message_unsaid(const char *format, ...)
{
    return (void)format, 0;
}

#define write_text(text, size, ...)                                                                                    \
    ((void)(0 && message_unsaid(__VA_ARGS__)), (void)(size), (void)((text)[0] = '\0'))
#define instance_row_label(i, row, label, size) ((void)(row), (void)(size), (label)[0] = '\0', (label))
#endif

static Outcome message_outcome(Outcome outcome)
{
    return outcome;
}

/* The text of a message is written where it has room; the outcome is what counts. */
#define instance_say(i, outcome, ...) (MESSAGE_SAY((i)->text, __VA_ARGS__), message_outcome(outcome))
#define instance_warn(i, of, ...)                                                                                      \
    do {                                                                                                               \
        if (!((i)->flags.warned & (of)))                                                                               \
            MESSAGE_SAY((i)->warning, __VA_ARGS__);                                                                    \
        (i)->flags.warned |= (of);                                                                                     \
        (i)->warns = 1;                                                                                                \
    } while (0)
#define MESSAGE_SAY(text, ...) write_text(text, sizeof text, __VA_ARGS__)
#define snprintf write_text
#define message_number(value) (value)

#endif
