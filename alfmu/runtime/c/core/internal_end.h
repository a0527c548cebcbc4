/* Ends the region that internal_begin.h begins. */

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility pop
#endif
