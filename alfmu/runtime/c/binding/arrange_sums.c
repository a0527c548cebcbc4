#include "arrange_sums.h"

#include "arrange_operations.h"
#include "operations.h"

static int term(Sums *f, int negative, int factor, int other)
{
    f->negative[f->terms] = negative;
    f->factor[f->terms] = factor;
    f->other[f->terms] = other;
    return f->terms++;
}

static void begun(Sums *f, int k, int first)
{
    f->begin[k] = f->end[k] = first;
    f->length[k] = 1;
}

static void append(Sums *f, int k, int last)
{
    f->next[f->end[k]] = last;
    f->end[k] = last;
    f->length[k]++;
}

/* Collect the summands of a + b or a - b; a sum used only there becomes part of the new one. */
static void join(Sums *f, int k, int a, int b, int difference)
{
    const int begins[2] = {f->uses[a] == 1 ? f->length[a] : 0, f->uses[b] == 1 ? f->length[b] : 0};
    const int products[2] = {begins[0] && f->codes[a] == PRODUCT_KIND, begins[1] && f->codes[b] == PRODUCT_KIND};
    const int more = products[0] != products[1] ? products[0] > products[1] : begins[1] > begins[0];
    const int turned = (!difference || products[1]) && more;
    const int first = turned ? b : a, second = turned ? a : b;
    if (begins[turned]) {
        f->begin[k] = f->begin[first];
        f->end[k] = f->end[first];
        f->length[k] = f->length[first];
        f->length[first] = 0;
    } else {
        begun(f, k, term(f, 0, first, -1));
    }
    if (turned && difference) /* a - b = -b + a */
        f->negative[f->begin[k]] = 1;
    if (products[!turned]) {
        int last = f->begin[second];
        f->length[second] = 0;
        f->negative[last] = difference && !turned;
        append(f, k, last);
    } else {
        append(f, k, term(f, difference && !turned, second, -1));
    }
}

/* Find the summands of each sum, in the order of addition. A sum that only begins another sum, or a product that only
   one sum uses, becomes part of that sum. */
void arrange_sums(Sums *f)
{
    for (int k = 0; k < f->count; k++) {
        const int code = f->codes[k], a = f->first[k], b = f->second[k];
        if (code == PRODUCT_KIND)
            begun(f, k, term(f, 0, a, b));
        else if (code == NEGATIVE_KIND || (code == PLUS_KIND && b < 0))
            begun(f, k, term(f, code == NEGATIVE_KIND, a, -1));
        else if (code == PLUS_KIND || code == MINUS_KIND)
            join(f, k, a, b, code == MINUS_KIND);
    }
}

/* Return the negative of a value. */
static int negative(Sums *f, int value)
{
    int constant = f->opposite[value];
    if (constant >= 0) {
        if (f->constants[constant] < 0)
            f->constants[constant] = f->values++;
        return f->constants[constant];
    }
    if (f->negatives[value] < 0) {
        f->negatives[value] = f->values++;
        f->made.operands[f->made.used] = value;
        arrange_add(&f->made, NEGATIVE_KIND, f->negatives[value], -1);
    }
    return f->negatives[value];
}

/* Negate one factor of each subtracted product. Many products share a few factors, which are negated once. */
void without_differences(Sums *f)
{
    Room *room = &f->room;
    int left = 0;
    int *ends = arrange_integers(room, (size_t)f->count + 2, 0),
        *there = arrange_integers(room, 2 * (size_t)f->terms, 0);
    int *pool = arrange_integers(room, 3 * (size_t)f->count, 0);
    if (room->missing)
        return;
    for (int filling = 0; filling < 2; filling++) {
        for (int k = 0; k < f->count; k++)
            for (int x = f->length[k] ? f->begin[k] : -1; x >= 0; x = f->next[x])
                if (f->negative[x] && f->other[x] >= 0)
                    for (int m = 0; m < 1 + (f->factor[x] != f->other[x]); m++) {
                        int factor = m ? f->other[x] : f->factor[x];
                        left += filling && !m;
                        if (filling)
                            there[ends[factor + 1]++] = x;
                        else
                            ends[factor + 2]++;
                    }
        for (int k = 0; !filling && k < f->count; k++)
            ends[k + 2] += ends[k + 1];
    }
    /* Prefer constants, which cost nothing, then the factors of most products. */
    Heap heap = {(int(*)[3])pool, 0};
    for (int x = 0; x < f->count; x++)
        if (ends[x + 1] > ends[x])
            arrange_push(&heap, f->opposite[x] < 0, ends[x] - ends[x + 1], x);
    while (left) {
        int taken[3], count = 0;
        arrange_pop(&heap, taken);
        const int factor = taken[2];
        for (int m = ends[factor]; m < ends[factor + 1]; m++)
            count += f->negative[there[m]];
        if (count != -taken[1]) {
            arrange_push(&heap, taken[0], -count, factor);
            continue;
        }
        for (int m = ends[factor]; m < ends[factor + 1]; m++) {
            int x = there[m];
            if (f->negative[x]) {
                int other = f->factor[x] == factor ? f->other[x] : f->factor[x];
                f->factor[x] = negative(f, factor);
                f->other[x] = other;
                f->negative[x] = 0;
                left--;
            }
        }
    }
}

/* Append the two factors of a summand; `neutral` are 1, -1 and -0. */
static void factors(Sums *f, int x, const int *neutral)
{
    int *operands = f->made.operands + f->made.used;
    operands[0] = f->factor[x];
    operands[1] = f->other[x] >= 0 ? f->other[x] : neutral[f->negative[x]];
    f->made.used += 2;
}

/* Write a sum as operations, each of which begins with the previous result. */
void arrange_write(Sums *f, int k)
{
    Operations *o = &f->made;
    const int *neutral = f->constants, nothing = neutral[2];
    int x = f->begin[k], left = f->length[k], made = -1;
    int second = f->next[x];
    if (left == 1) {
        int *operands = o->operands + o->used;
        operands[0] = f->factor[x];
        operands[1] = f->other[x] >= 0 ? f->other[x] : nothing;
        arrange_add(o, f->other[x] >= 0 ? PRODUCT_KIND : f->negative[x] ? NEGATIVE_KIND : PLUS_KIND, k, -1);
        return;
    }
    if (f->other[x] >= 0 && !f->negative[second] && f->other[second] < 0) {
        made = f->factor[second];
        f->next[x] = f->next[second];
        left--;
    } else if (f->other[x] >= 0) {
        int used = o->used;
        factors(f, x, neutral);
        factors(f, second, neutral);
        o->used = used;
        left -= 2;
        made = left ? f->values++ : k;
        arrange_add(o, PRODUCTS_KIND, made, -1);
        x = f->next[second];
    } else if (f->negative[x]) {
        made = nothing;
    } else {
        made = f->factor[x];
        x = second;
        left--;
    }
    while (left) {
        const int count = left >= 4 ? 4 : left >= 2 ? 2 : 1, used = o->used;
        int kind = count == 4 ? SUM4_KIND : count == 2 ? SUM2_KIND : SUM1_KIND;
        o->operands[o->used++] = made;
        if (count == 1 && f->other[x] < 0) {
            kind = f->negative[x] ? MINUS_KIND : PLUS_KIND;
            o->operands[o->used++] = f->factor[x];
            x = f->next[x];
        } else {
            for (int m = 0; m < count; m++, x = f->next[x])
                factors(f, x, neutral);
        }
        o->used = used;
        left -= count;
        made = left ? f->values++ : k;
        arrange_add(o, kind, made, -1);
    }
}
