#include "text.h"

#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

/* Before and after each number, until the text is whole. */
#define BEGINS '\1'
#define ENDS '\2'

/* Longest format of a message: no longer than the message itself may be. */
#define LONGEST 1024

/* A format that marks the numbers with a point. */
static void mark(const char *format, char *marked)
{
    char *const end = marked + LONGEST - 3;
    while (*format && marked < end) {
        const size_t length = *format == '%' ? 1 + strcspn(format + 1, "cdeEfgGlpsuxz%") : 0;
        const int number = length && format[length] && strchr("eEfgG", format[length]);
        if (number)
            *marked++ = BEGINS;
        for (size_t k = 0; k <= length && *format && marked < end; k++)
            *marked++ = *format++;
        if (number)
            *marked++ = ENDS;
    }
    *marked = '\0';
}

void write_list(char *text, size_t size, const char *format, va_list arguments)
{
    char marked[LONGEST], *to = text, before = '\0';
    int number = 0;
    mark(format, marked);
    vsnprintf(text, size, marked, arguments);
    for (const char *from = text; *from; from++)
        if (*from == BEGINS || *from == ENDS)
            number = *from == BEGINS;
        else if (number && !strchr("+-0123456789aefinx", *from)) { /* One point for a sign of any length. */
            if (before != '.')
                before = *to++ = '.';
        } else
            before = *to++ = *from;
    if (size)
        *to = '\0';
}

void write_text(char *text, size_t size, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    write_list(text, size, format, arguments);
    va_end(arguments);
}
