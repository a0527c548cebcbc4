#include "function_tangents.h"

#include "gradient.h"
#include "lanes.h"
#include "operations.h"
#include "rare_operations.h"

#define R(k) r[at[k]]
#define T(k) dr[at[k]].part[part]
#define TANGENT_SUM(kind, operands, value) \
    case kind: \
        for (; count; count--, at += operands, d++) \
            EACH_PART d->part[part] = value; \
        break;

/* Add the tangents of an operand times the partial derivative. */
void tangent_along(Lanes *d, double partial, const Lanes *tangent)
{
    if (partial != 0.0)
        for (int lane = 0; lane < LANES; lane++)
            if (tangent->lane[lane] != 0.0)
                d->lane[lane] += partial * tangent->lane[lane];
}

static BY_PROCESSOR void through(const Flat *flat, const double *r, Lanes *dr)
{
    for (int k = 0; k < flat->count; k++) {
        const Run_of *run = flat->runs + k;
        const int32_t *at = run->operands;
        int32_t count = run->count;
        Lanes *d = dr + run->result;
        switch (run->kind) {
            TANGENT_SUM(SUM1_KIND, 3, T(0) + (T(1) * R(2) + R(1) * T(2)))
            TANGENT_SUM(SUM2_KIND, 5, T(0) + (T(1) * R(2) + R(1) * T(2)) + (T(3) * R(4) + R(3) * T(4)))
            TANGENT_SUM(SUM4_KIND, 9,
                T(0) + (T(1) * R(2) + R(1) * T(2)) + (T(3) * R(4) + R(3) * T(4)) + (T(5) * R(6) + R(5) * T(6))
                    + (T(7) * R(8) + R(7) * T(8)))
            TANGENT_SUM(PRODUCT_KIND, 2, T(0) * R(1) + R(0) * T(1))
            TANGENT_SUM(PRODUCTS_KIND, 4, (T(0) * R(1) + R(0) * T(1)) + (T(2) * R(3) + R(2) * T(3)))
            TANGENT_SUM(PLUS_KIND, 2, T(0) + T(1))
            TANGENT_SUM(MINUS_KIND, 2, T(0) - T(1))
            TANGENT_SUM(NEGATIVE_KIND, 1, -T(0))
            TANGENT_SUM(KIND_COUNT, 1, T(0)) /* copy */
        case OVER_KIND:
            for (int32_t c = run->result; count; count--, at += 2, d++, c++) {
                const double inverse = 1.0 / R(1), minus = -r[c] * inverse;
                EACH_PART d->part[part] = T(0) * inverse + T(1) * minus;
            }
            break;
        case SINE_COSINE_KIND:
            for (int32_t c = run->result; count; count--, at++, d += 2, c += 2)
                EACH_PART
                {
                    d[0].part[part] = T(0) * r[c + 1];
                    d[1].part[part] = -T(0) * r[c];
                }
            break;
        default: {
            const int operands = 1 + IS_BINARY(run->kind);
            for (; count; count--, at += operands, d++) {
                double of[2];
                operation_partials(run->kind, R(0), R(operands - 1), of);
                memset(d, 0, sizeof *d);
                for (int j = 0; j < operands; j++)
                    tangent_along(d, of[j], dr + at[j]);
            }
        }
        }
    }
}

/* Static in its versions, as those of `lanes.c`. */
void tangents_through(const Flat *flat, const double *r, Lanes *dr)
{
    through(flat, r, dr);
}
