/* The part of the C library that computations need. Versions of its functions are those that every glibc has, so that a
   library built with a newer one also runs on older systems; the newer versions differ only in errno. */

#pragma once

#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined(__GLIBC__) && defined(__GNUC__)
#if defined(__x86_64__)
#define ALFMU_OLD(NAME) __asm__(".symver " #NAME ", " #NAME "@GLIBC_2.2.5");
#elif defined(__aarch64__)
#define ALFMU_OLD(NAME) __asm__(".symver " #NAME ", " #NAME "@GLIBC_2.17");
#endif
#endif

#if defined(ALFMU_OLD)
ALFMU_OLD(acos) ALFMU_OLD(acosh) ALFMU_OLD(asin) ALFMU_OLD(asinh) ALFMU_OLD(atan) ALFMU_OLD(atan2) ALFMU_OLD(atanh)
ALFMU_OLD(cos) ALFMU_OLD(cosh) ALFMU_OLD(erf) ALFMU_OLD(exp) ALFMU_OLD(expm1) ALFMU_OLD(fmod) ALFMU_OLD(hypot)
ALFMU_OLD(log) ALFMU_OLD(log1p) ALFMU_OLD(pow) ALFMU_OLD(remainder) ALFMU_OLD(sin) ALFMU_OLD(sinh) ALFMU_OLD(tan)
ALFMU_OLD(tanh)
#endif
