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

/* Rare operations. */
#define IN_LANES(kind, value) \
    case kind: \
        for (int lane = 0; lane < LANES; lane++) { \
            const double a = x->lane[lane], b = y->lane[lane]; \
            (void)b; \
            values->lane[lane] = value; \
        } \
        break;

static BY_PROCESSOR void operate(
    uint32_t kind, const Lanes *restrict x, const Lanes *restrict y, Lanes *restrict values)
{
    switch (kind) {
        BINARY_OPERATIONS(IN_LANES)
        UNARY_OPERATIONS(IN_LANES)
    }
}

#define PLACED(k) r[at[k]].part[part]
#define EACH for (int part = 0; part < parts; part++)
#define SIDE_BY_SIDE(kind, operands, value) \
    case kind: \
        for (; count; count--, at += operands, d++) \
            EACH d->part[part] = value; \
        break;

/* A run of short operations: the compiler replaces the loop over the lanes by vectors. The value is stored as a whole,
   since a vector that is read soon after its parts are stored has to wait for them. */
#define IN_VECTORS(kind, value) \
    case kind: \
        for (; count; count--, at += 1 + IS_BINARY(kind), d++) { \
            const Lanes x = r[at[0]].lanes, y = r[at[IS_BINARY(kind)]].lanes; \
            Lanes z; \
            for (int lane = 0; lane < LANES; lane++) { \
                const double a = x.lane[lane], b = y.lane[lane]; \
                (void)b; \
                z.lane[lane] = value; \
            } \
            d->lanes = z; \
        } \
        break;

/* Define a function that runs code on registers in lanes, each of which has some vectors of `width` numbers. */
#define LANES_RUN(name, target, width) \
    SINE_COSINE_IN_LANES(static inline __attribute__((always_inline)), name##_sine_cosine, width) \
    static target void name(const uint16_t *at, const uint16_t *end, Lanes *registers) \
    { \
        typedef union { \
            name##_sine_cosine_real part[LANES / width]; \
            Lanes lanes; \
        } Register; \
        Register *const r = (Register *)(void *)registers; \
        enum { parts = LANES / width }; \
        while (at < end) { \
            const uint32_t head = at[0]; \
            uint32_t count = at[1]; \
            Register *d = r + at[2]; \
            at += NARROW_HEAD; \
            switch (head) { \
                SIDE_BY_SIDE(SUM1_KIND, 3, SUM1(PLACED(0), PLACED(1), PLACED(2))) \
                SIDE_BY_SIDE(SUM2_KIND, 5, SUM2(PLACED(0), PLACED(1), PLACED(2), PLACED(3), PLACED(4))) \
                SIDE_BY_SIDE(SUM4_KIND, 9, \
                    SUM4(PLACED(0), PLACED(1), PLACED(2), PLACED(3), PLACED(4), PLACED(5), PLACED(6), PLACED(7), \
                        PLACED(8))) \
                SIDE_BY_SIDE(PRODUCTS_KIND, 4, PRODUCTS(PLACED(0), PLACED(1), PLACED(2), PLACED(3))) \
                SIDE_BY_SIDE(PRODUCT_KIND, 2, PLACED(0) * PLACED(1)) \
                SIDE_BY_SIDE(PLUS_KIND, 2, PLACED(0) + PLACED(1)) \
                SIDE_BY_SIDE(MINUS_KIND, 2, PLACED(0) - PLACED(1)) \
                SIDE_BY_SIDE(OVER_KIND, 2, PLACED(0) / PLACED(1)) \
                SIDE_BY_SIDE(NEGATIVE_KIND, 1, -PLACED(0)) \
            case SINE_COSINE_KIND: \
                for (; count; count--, at++, d += 2) \
                    EACH name##_sine_cosine(&PLACED(0), &d[0].part[part], &d[1].part[part]); \
                break; \
            SHORT_OPERATIONS(IN_VECTORS) \
            default: { \
                const int operands = 1 + IS_BINARY(head); \
                for (; count; count--, at += operands, d++) \
                    operate(head, &r[at[0]].lanes, &r[at[operands - 1]].lanes, &d->lanes); \
            } \
            } \
        } \
    }

LANES_RUN(run_in_parts, BY_PROCESSOR, PART)
/* Code for processors whose vectors have all lanes. Compilers may fuse its operations, so only the package's own build,
   which forbids this, asks for it. */
#if defined(WHOLE_LANES) && PART == 4
#define HAS_WHOLE 1
#else
#define HAS_WHOLE 0
#endif
#if HAS_WHOLE
LANES_RUN(run_whole, __attribute__((target("avx512f"))), LANES)
#else
#define run_whole run_in_parts
#endif

int lanes_compiled(void)
{
#if HAS_WHOLE
    if (__builtin_cpu_supports("avx512f"))
        return LANES;
#endif
    return 4;
}

void lanes_evaluate(const Function *f, Lanes *r)
{
    if (lanes_compiled() == LANES)
        run_whole(f->narrow, f->narrow + f->words, r);
    else
        run_in_parts(f->narrow, f->narrow + f->words, r);
}

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

static int are_one(int lanes, const double *const *x)
{
    int one = 1;
    for (int lane = 1; lane < lanes; lane++)
        one &= x[lane] == x[0];
    return one;
}

static BY_PROCESSOR void gather(double *rows, int lanes, const double *const *x, int length)
{
    int each = 0;
    if (are_one(lanes, x))
        for (; each < length; each++, rows += lanes)
            for (int lane = 0; lane < lanes; lane += 4)
                FOUR(rows + lane) = (Four){x[0][each], x[0][each], x[0][each], x[0][each]};
    for (; each + 4 <= length; each += 4, rows += 4 * lanes)
        for (int lane = 0; lane < lanes; lane += 4) {
            const double *const *from = x + lane;
            Four a = FOUR(from[0] + each), b = FOUR(from[1] + each), c = FOUR(from[2] + each), d = FOUR(from[3] + each);
            transpose(&a, &b, &c, &d);
            FOUR(rows + lane) = a;
            FOUR(rows + lane + lanes) = b;
            FOUR(rows + lane + 2 * lanes) = c;
            FOUR(rows + lane + 3 * lanes) = d;
        }
    for (; each < length; each++)
        for (int lane = 0; lane < lanes; lane++)
            *rows++ = x[lane][each];
}

static BY_PROCESSOR void scatter(
    const double *rows, int lanes, const uint16_t *from, double *const *y, int length, int count)
{
    int each = 0;
    for (; each + 4 <= length; each += 4)
        for (int lane = 0; lane < count; lane += 4) {
            Four row[4];
            for (int k = 0; k < 4; k++)
                row[k] = FOUR(rows + (from ? from[each + k] : each + k) * lanes + lane);
            transpose(row, row + 1, row + 2, row + 3);
            for (int k = 0; k < 4 && lane + k < count; k++)
                FOUR(y[lane + k] + each) = row[k];
        }
    for (; each < length; each++)
        for (int lane = 0; lane < count; lane++)
            y[lane][each] = rows[(from ? from[each] : each) * lanes + lane];
}

/* Clang needs functions with versions for several processors to be declared as such, and GCC must not see such
   declarations in other files, so that these are static. */
void lanes_gather(double *rows, int lanes, const double *const *x, int length)
{
    gather(rows, lanes, x, length);
}

void lanes_scatter(const double *rows, int lanes, const uint16_t *from, double *const *y, int length, int count)
{
    scatter(rows, lanes, from, y, length, count);
}

#endif

double *lanes_align(double *place)
{
    const size_t line = LANES * sizeof *place, behind = (uintptr_t)place % line;
    return place + (behind ? (line - behind) / sizeof *place : 0);
}
