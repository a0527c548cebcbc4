/* Declarations from here to internal_end.h are visible within the library only, even if an importer compiles it, as
   other libraries may use the same names. They use versions of C library functions that every glibc has. */

#include "baseline.h"

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility push(hidden)
#endif

/* Positions of a format and of its first argument among the arguments of a function. */
#if !defined(PRINTF_LIKE)
#if defined(__GNUC__)
#define PRINTF_LIKE(format_at, first) __attribute__((format(printf, format_at, first)))
#else
#define PRINTF_LIKE(format_at, first)
#endif
#endif
