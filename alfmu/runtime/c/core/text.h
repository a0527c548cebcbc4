/* Text whose numbers have a decimal point in every locale of the host. */

#ifndef ALFMU_TEXT_H
#define ALFMU_TEXT_H

#include <stdarg.h>
#include <stddef.h>

#include "internal_begin.h"

/* As vsnprintf and snprintf. */
void write_list(char *text, size_t size, const char *format, va_list arguments);

void write_text(char *text, size_t size, const char *format, ...) PRINTF_LIKE(3, 4);

#include "internal_end.h"

#endif
