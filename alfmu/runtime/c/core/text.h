/* Text whose numbers have a decimal point in every locale of the host. */

#pragma once

#include <stdarg.h>

#include "baseline.h"

/* Positions of a format and of its first argument among the arguments of a function. */
#if defined(__GNUC__)
#define PRINTF_LIKE(format_at, first) __attribute__((format(printf, format_at, first)))
#else
#define PRINTF_LIKE(format_at, first)
#endif

/* As vsnprintf and snprintf. */
void write_list(char *text, size_t size, const char *format, va_list arguments);

void write_text(char *text, size_t size, const char *format, ...) PRINTF_LIKE(3, 4);
