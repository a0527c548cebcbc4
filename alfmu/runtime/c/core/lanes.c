/* A function is evaluated for several sets of arguments side by side, each set in a lane of its own. Each operation is
   done in all lanes, so that its operands are looked up once. Results are those of one call after the other, to the
   last bit; compilers without vectors make such calls. */

#include "lanes.h"

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "operations.h"
#include "scene.h"
#include "sums.h"

#if defined(__GNUC__)

#define PLACED(k) r[at[k]].part[part]
#define SIDE_BY_SIDE(kind, operands, value) \
    case kind: \
        for (; count; count--, at += operands, d++) \
            EACH_PART d->part[part] = value; \
        break;
#define IN_LANES(kind, value) \
    case kind: \
        for (int lane = 0; lane < LANES; lane++) { \
            const double a = x->lane[lane], b = y->lane[lane]; \
            (void)b; \
            values->lane[lane] = value; \
        } \
        break;

/* Do an operation other than a sum in all lanes. */
static BY_PROCESSOR void operate(
    uint32_t kind, const Lanes *restrict x, const Lanes *restrict y, Lanes *restrict values)
{
    switch (kind) {
        BINARY_OPERATIONS(IN_LANES)
        UNARY_OPERATIONS(IN_LANES)
    }
}

static BY_PROCESSOR void lanes_run(const uint16_t *at, const uint16_t *end, Lanes *r)
{
    while (at < end) {
        const uint32_t head = at[0];
        uint32_t count = at[1];
        Lanes *d = r + at[2];
        at += NARROW_HEAD;
        switch (head) {
            SIDE_BY_SIDE(SUM1_KIND, 3, SUM1(PLACED(0), PLACED(1), PLACED(2)))
            SIDE_BY_SIDE(SUM2_KIND, 5, SUM2(PLACED(0), PLACED(1), PLACED(2), PLACED(3), PLACED(4)))
            SIDE_BY_SIDE(SUM4_KIND, 9,
                SUM4(PLACED(0), PLACED(1), PLACED(2), PLACED(3), PLACED(4), PLACED(5), PLACED(6), PLACED(7), PLACED(8)))
            SIDE_BY_SIDE(PRODUCTS_KIND, 4, PRODUCTS(PLACED(0), PLACED(1), PLACED(2), PLACED(3)))
            SIDE_BY_SIDE(PRODUCT_KIND, 2, PLACED(0) * PLACED(1))
            SIDE_BY_SIDE(PLUS_KIND, 2, PLACED(0) + PLACED(1))
            SIDE_BY_SIDE(MINUS_KIND, 2, PLACED(0) - PLACED(1))
            SIDE_BY_SIDE(OVER_KIND, 2, PLACED(0) / PLACED(1))
            SIDE_BY_SIDE(NEGATIVE_KIND, 1, -PLACED(0))
        case SINE_COSINE_KIND:
            for (; count; count--, at++, d += 2)
                for (int lane = 0; lane < LANES; lane++) {
                    const double a = r[at[0]].lane[lane];
                    d[0].lane[lane] = sin(a);
                    d[1].lane[lane] = cos(a);
                }
            break;
        default: {
            const int operands = 1 + IS_BINARY(head);
            for (; count; count--, at += operands, d++)
                operate(head, r + at[0], r + at[operands - 1], d);
        }
        }
    }
}

BY_PROCESSOR void lanes_gather(double *rows, int step, const double *const *x, int length)
{
    const double *const a = x[0], *const b = x[1], *const c = x[2], *const d = x[3];
    for (int each = 0; each < length; each++, rows += step)
        *(LaneRow *)(void *)rows = (LaneRow){a[each], b[each], c[each], d[each]};
}

void lanes_evaluate(const Function *f, Lanes *r)
{
    lanes_run(f->narrow, f->narrow + f->words, r);
}

void lanes_scatter(const Lanes *r, const uint16_t *from, double *const *y, int length, int count)
{
    for (int lane = 0; lane < count; lane++)
        for (int each = 0; each < length; each++)
            y[lane][each] = r[from[each]].lane[lane];
}

#endif


double *lanes_align(double *place)
{
    const size_t line = LANES * sizeof *place, behind = (uintptr_t)place % line;
    return place + (behind ? (line - behind) / sizeof *place : 0);
}
