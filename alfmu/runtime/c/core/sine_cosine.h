/* The sine and the cosine of an angle, for numbers and for vectors, with the same bits on every processor. Errors are
   below 0.8 units in the last place. */

#pragma once

#include <math.h>
#include <stdint.h>
#include <string.h>

#define MOST_ANGLE 1e6 /* larger angles are left to the C library */
#define QUARTERS 6755399441055744.0 /* 1.5 * 2^52: a sum with it is rounded to whole numbers, which are its last bits */

/* Reduce an angle to the nearest multiple of pi / 2 (Cody and Waite 1980), where pi / 2 has four parts, of which the
   first three have exact products; then polynomials of least relative error up to pi / 4 in its square z. */
#define SINE_COSINE(inlined, name, Real, Integer) \
    inlined void name(const Real *angle, Real *sine, Real *cosine) \
    { \
        const Real sum = *angle * 0.6366197723675814 + QUARTERS, quarters = sum - QUARTERS; \
        const Real second = quarters * 6.077100506303966e-11, third = quarters * 2.0222662487111665e-21; \
        const Real near = *angle - quarters * 1.5707963267341256, nearer = near - second, y = nearer - third; \
        const Real rest = ((nearer - y) - third) + ((near - nearer) - second) - quarters * 8.4784276603689e-32; \
        const Real z = y * y, half = 0.5 * z, below = 1.0 - half, cube = z * y; \
        const Real odd = 0.008333333333322413 \
            + z * (-0.00019841269829807737 \
                + z * (2.755731369190013e-06 + z * (-2.5050758113115238e-08 + z * 1.5896795552810856e-10))); \
        const Real even = 0.0416666666666666 \
            + z * (-0.0013888888888874125 \
                + z * (2.4801587289482242e-05 \
                    + z * (-2.755731435234916e-07 + z * (2.0875723275319916e-09 + z * -1.1359647902961221e-11)))); \
        const Real s = y - ((z * (0.5 * rest - cube * odd) - rest) + cube * 0.16666666666666632); \
        const Real c = below + (((1.0 - below) - half) + (z * (z * even) - y * rest)); \
        Integer quarter, a, b, swapped; \
        memcpy(&quarter, &sum, sizeof quarter); \
        memcpy(&a, &s, sizeof a); \
        memcpy(&b, &c, sizeof b); \
        swapped = (a ^ b) & -(quarter & 1); \
        a ^= swapped ^ ((quarter & 2) << 62); \
        b ^= swapped ^ (((quarter + 1) & 2) << 62); \
        memcpy(sine, &a, sizeof a); \
        memcpy(cosine, &b, sizeof b); \
    }

SINE_COSINE(static inline, sine_cosine_near, double, uint64_t)

static inline void sine_cosine(double angle, double *sine, double *cosine)
{
    if (fabs(angle) < MOST_ANGLE) {
        sine_cosine_near(&angle, sine, cosine);
    } else {
        *sine = sin(angle);
        *cosine = cos(angle);
    }
}

/* The same for vectors. */
#define SINE_COSINE_IN_LANES(inlined, name, count) \
    typedef double name##_real __attribute__((vector_size(8 * (count)))); \
    typedef uint64_t name##_integer __attribute__((vector_size(8 * (count)))); \
    SINE_COSINE(inlined, name##_near, name##_real, name##_integer) \
    inlined void name(const name##_real *angle, name##_real *sine, name##_real *cosine) \
    { \
        const name##_real angles = *angle; \
        int near = 1; \
        for (int lane = 0; lane < (count); lane++) \
            near &= fabs(angles[lane]) < MOST_ANGLE; \
        if (near) { \
            name##_near(&angles, sine, cosine); \
            return; \
        } \
        for (int lane = 0; lane < (count); lane++) { \
            double s, c; \
            sine_cosine(angles[lane], &s, &c); \
            (*sine)[lane] = s; \
            (*cosine)[lane] = c; \
        } \
    }
