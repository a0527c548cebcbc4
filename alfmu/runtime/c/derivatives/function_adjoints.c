#include "function_adjoints.h"

#include "gradient.h"
#include "operations.h"
#include "rare_operations.h"

#define R(k) r[at[k]]
#define A(k) ar[at[k]]
#define ADJOINT_SUM(kind, operands, text) \
    case kind: \
        for (; count; count--, at -= operands, d--) { \
            const double w = *d; \
            if (w != 0.0) { \
                text \
            } \
        } \
        break;
#define FACTORS(i, j) \
    { \
        const double x = R(i), y = R(j); \
        A(i) += w * y; \
        A(j) += w * x; \
    }

void adjoints_through(const Flat *flat, const double *r, double *ar)
{
    static const unsigned char operands[] = {OPERAND_COUNTS, 1};
    for (int k = flat->count; k--;) {
        const Run_of *run = flat->runs + k;
        int32_t count = run->count;
        const int32_t *at = run->operands + (count - 1) * operands[run->kind];
        const double *d = ar + run->result + count - 1;
        switch (run->kind) {
            ADJOINT_SUM(SUM1_KIND, 3, A(0) += w; FACTORS(1, 2))
            ADJOINT_SUM(SUM2_KIND, 5, A(0) += w; FACTORS(1, 2) FACTORS(3, 4))
            ADJOINT_SUM(SUM4_KIND, 9, A(0) += w; FACTORS(1, 2) FACTORS(3, 4) FACTORS(5, 6) FACTORS(7, 8))
            ADJOINT_SUM(PRODUCT_KIND, 2, FACTORS(0, 1))
            ADJOINT_SUM(PRODUCTS_KIND, 4, FACTORS(0, 1) FACTORS(2, 3))
            ADJOINT_SUM(PLUS_KIND, 2, A(0) += w; A(1) += w;)
            ADJOINT_SUM(MINUS_KIND, 2, A(0) += w; A(1) -= w;)
            ADJOINT_SUM(NEGATIVE_KIND, 1, A(0) -= w;)
            ADJOINT_SUM(KIND_COUNT, 1, A(0) += w;) /* copy */
        case OVER_KIND:
            for (int32_t c = run->result + count - 1; count; count--, at -= 2, d--, c--)
                if (*d != 0.0) {
                    const double w = *d / R(1);
                    A(0) += w;
                    A(1) -= w * r[c];
                }
            break;
        case SINE_COSINE_KIND:
            for (int32_t c = run->result + 2 * (count - 1); count; count--, at--, c -= 2)
                A(0) += ar[c] * r[c + 1] - ar[c + 1] * r[c];
            break;
        default: {
            const int each = operands[run->kind];
            for (; count; count--, at -= each, d--)
                if (*d != 0.0) {
                    double of[2];
                    operation_partials(run->kind, R(0), R(each - 1), of);
                    for (int j = 0; j < each; j++)
                        if (of[j] != 0.0)
                            A(j) += *d * of[j];
                }
        }
        }
    }
}
