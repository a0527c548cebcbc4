/* A function is evaluated for several sets of arguments side by side, each set in a lane of its own. Each operation is
   done in all lanes, so that its operands are looked up once. Results are those of one call after the other, to the
   last bit; compilers without vectors make such calls. */

#include "lanes.h"

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "operations.h"
#include "scene.h"
#include "sine_cosine.h"
#include "sums.h"

#if defined(__GNUC__)

SINE_COSINE_IN_LANES(sine_cosine_of, PART)

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
                EACH_PART sine_cosine_of(&r[at[0]].part[part], &d[0].part[part], &d[1].part[part]);
            break;
        default: {
            const int operands = 1 + IS_BINARY(head);
            for (; count; count--, at += operands, d++)
                operate(head, r + at[0], r + at[operands - 1], d);
        }
        }
    }
}

/* Four numbers at any address. */
typedef double Four __attribute__((vector_size(32), aligned(8), may_alias));
#if defined(__clang__)
#define PICK(x, y, a, b, c, d) __builtin_shufflevector(x, y, a, b, c, d)
#else
typedef int64_t Four_places __attribute__((vector_size(32)));
#define PICK(x, y, a, b, c, d) __builtin_shuffle(x, y, (Four_places){a, b, c, d})
#endif

/* Transpose four rows of four numbers. */
static inline __attribute__((always_inline)) void transpose(Four *a, Four *b, Four *c, Four *d)
{
    const Four ab = PICK(*a, *b, 0, 4, 2, 6), ba = PICK(*a, *b, 1, 5, 3, 7);
    const Four cd = PICK(*c, *d, 0, 4, 2, 6), dc = PICK(*c, *d, 1, 5, 3, 7);
    *a = PICK(ab, cd, 0, 1, 4, 5);
    *b = PICK(ba, dc, 0, 1, 4, 5);
    *c = PICK(ab, cd, 2, 3, 6, 7);
    *d = PICK(ba, dc, 2, 3, 6, 7);
}

#define FOUR(address) (*(Four *)(void *)(address))

BY_PROCESSOR void lanes_gather(Lanes *rows, const double *const *x, int length)
{
    int each = 0;
    for (; each + 4 <= length; each += 4)
        for (int half = 0; half < LANES; half += 4) {
            Four a = *(const Four *)(const void *)(x[half] + each), b = *(const Four *)(const void *)(x[half + 1] + each);
            Four c = *(const Four *)(const void *)(x[half + 2] + each), d = *(const Four *)(const void *)(x[half + 3] + each);
            transpose(&a, &b, &c, &d);
            FOUR(rows[each].lane + half) = a;
            FOUR(rows[each + 1].lane + half) = b;
            FOUR(rows[each + 2].lane + half) = c;
            FOUR(rows[each + 3].lane + half) = d;
        }
    for (; each < length; each++)
        for (int lane = 0; lane < LANES; lane++)
            rows[each].lane[lane] = x[lane][each];
}

void lanes_evaluate(const Function *f, Lanes *r)
{
    lanes_run(f->narrow, f->narrow + f->words, r);
}

BY_PROCESSOR void lanes_scatter(const Lanes *r, const uint16_t *from, double *const *y, int length, int count)
{
    int each = 0;
    for (; each + 4 <= length; each += 4)
        for (int half = 0; half < count; half += 4) {
            Four a = *(const Four *)(const void *)(r[from[each]].lane + half);
            Four b = *(const Four *)(const void *)(r[from[each + 1]].lane + half);
            Four c = *(const Four *)(const void *)(r[from[each + 2]].lane + half);
            Four d = *(const Four *)(const void *)(r[from[each + 3]].lane + half);
            transpose(&a, &b, &c, &d);
            FOUR(y[half] + each) = a;
            if (count > half + 1)
                FOUR(y[half + 1] + each) = b;
            if (count > half + 2)
                FOUR(y[half + 2] + each) = c;
            if (count > half + 3)
                FOUR(y[half + 3] + each) = d;
        }
    for (; each < length; each++)
        for (int lane = 0; lane < count; lane++)
            y[lane][each] = r[from[each]].lane[lane];
}

#endif


double *lanes_align(double *place)
{
    const size_t line = LANES * sizeof *place, behind = (uintptr_t)place % line;
    return place + (behind ? (line - behind) / sizeof *place : 0);
}
