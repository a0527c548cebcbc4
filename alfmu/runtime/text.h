/* Texts whose numbers have a point wherever the host is. */

#ifndef ALFMU_TEXT_H
#define ALFMU_TEXT_H

#include <stdarg.h>
#include <stddef.h>

/* Also where an importer compiles this. */
#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility push(hidden)
#endif

/* As vsnprintf and snprintf. */
void write_list(char *text, size_t size, const char *format, va_list arguments);
void write_text(char *text, size_t size, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 3, 4)))
#endif
    ;

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility pop
#endif

#endif
