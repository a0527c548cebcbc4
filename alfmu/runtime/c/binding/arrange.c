/* Orders the operations of a function for the interpreter, for `alfmu.kernel.arrangement`. No scene needs it to run. */

#include "arrange.h"

#include "arrange_operations.h"
#include "arrange_sums.h"
#include "operations.h"

#define MOST_OPERANDS 9

/* Neutral numbers, in place of operands. */
enum { ONE = -1, MINUS_ONE = -2, NOTHING = -3 };

/* Operations expressed by another kind: places of their own operands, or neutral numbers. */
static const struct {
    int one, other, operands[5];
} AS[] = {
    {PLUS_KIND, SUM1_KIND, {0, 1, ONE}},
    {MINUS_KIND, SUM1_KIND, {0, 1, MINUS_ONE}},
    {PRODUCT_KIND, SUM1_KIND, {NOTHING, 0, 1}},
    {NEGATIVE_KIND, SUM1_KIND, {NOTHING, 0, MINUS_ONE}},
    {NEGATIVE_KIND, PRODUCT_KIND, {0, MINUS_ONE}},
    {SUM1_KIND, SUM2_KIND, {0, 1, 2, NOTHING, ONE}},
    {PRODUCTS_KIND, SUM2_KIND, {NOTHING, 0, 1, 2, 3}},
    {PRODUCT_KIND, PRODUCTS_KIND, {0, 1, NOTHING, ONE}},
    {PLUS_KIND, PRODUCTS_KIND, {0, ONE, 1, ONE}},
    {MINUS_KIND, PRODUCTS_KIND, {0, ONE, 1, MINUS_ONE}},
};

/* Most operations that join a run of another kind: they cost more there, but less than a run of their own, above all if
   the processor does not predict the sequence of runs. */
#define FEW 2

/* Return the cycles of an operation, with operands and result in memory. */
static int cycles(int kind)
{
    switch (kind) {
        case OVER_KIND:
            return 20;
        case SINE_COSINE_KIND:
            return 50;
        case SUM2_KIND:
        case PRODUCTS_KIND:
            return 17;
        case SUM4_KIND:
            return 23;
        default:
            return 14;
    }
}

/* A run while it is made: numbers of its operations, their operands, places of the operands, and the length of the
   chain of operations of this run that each waits for. */
typedef struct {
    int each, *numbers, *operands, *places, *after;
} Kind_run;

static int precedes(const Kind_run *run, int a, int b)
{
    if (run->after[a] != run->after[b])
        return run->after[a] < run->after[b];
    for (int k = 0; k < run->each; k++) {
        int x = run->places[a * run->each + k], y = run->places[b * run->each + k];
        if (x != y)
            return x < y;
    }
    return a < b;
}

/* Sort the first `count` entries of `order` by merging; `beside` is scratch of the same length. */
static void sort(const Kind_run *run, int *order, int *beside, int count)
{
    for (int width = 1; width < count; width *= 2) {
        for (int begin = 0; begin < count; begin += 2 * width) {
            int middle = begin + width < count ? begin + width : count;
            int end = begin + 2 * width < count ? begin + 2 * width : count;
            for (int k = begin, a = begin, b = middle; k < end; k++)
                beside[k] = a < middle && (b >= end || precedes(run, order[a], order[b])) ? order[a++] : order[b++];
        }
        for (int k = 0; k < count; k++)
            order[k] = beside[k];
    }
}

/* List the users of each result, from ends[i] to ends[i + 1] of an array; count the operands each operation waits for.
   */
static int *users_of(Room *room, const Operations *o, int values, int *ends, int *missing)
{
    int *maker = arrange_integers(room, (size_t)values, -1), *users = NULL, total = 0;
    for (int i = 0; maker && i < o->count; i++)
        for (int k = 0; k < 2; k++)
            if (o->made[i][k] >= 0)
                maker[o->made[i][k]] = i;
    for (int filling = 0; maker && filling < 2; filling++) {
        for (int i = 0; i < o->count; i++) {
            int makers[MOST_OPERANDS], count = 0;
            for (int k = 0; k < OPERANDS[o->kinds[i]]; k++) {
                int j = maker[o->operands[o->begins[i] + k]], known = 0;
                for (int m = 0; m < count; m++)
                    known |= makers[m] == j;
                if (j >= 0 && !known)
                    makers[count++] = j;
            }
            missing[i] = count;
            for (int m = 0; m < count; m++) {
                if (filling)
                    users[ends[makers[m] + 1]++] = i;
                else
                    ends[makers[m] + 2]++;
            }
            total += filling ? 0 : count;
        }
        if (!filling) {
            for (int i = 0; i < o->count; i++)
                ends[i + 2] += ends[i + 1];
            users = arrange_integers(room, (size_t)total, 0);
            if (!users)
                break;
        }
    }
    return users;
}

/* Compute two priorities of each operation, negative so that the least comes first: the least number of changes of kind
   after it, and the cycles of the longest chain that depends on it. */
static void urgency(Room *room, const Operations *o, const int *users, const int *ends, const int *missing,
    int *changes, int *chains)
{
    int *order = arrange_integers(room, (size_t)o->count, 0), *left = arrange_integers(room, (size_t)o->count, 0),
        count = 0;
    if (room->missing)
        return;
    for (int i = 0; i < o->count; i++) {
        left[i] = missing[i];
        if (!left[i])
            order[count++] = i;
    }
    for (int k = 0; k < count; k++)
        for (int m = ends[order[k]]; m < ends[order[k] + 1]; m++)
            if (!--left[users[m]])
                order[count++] = users[m];
    while (count--) {
        int i = order[count], kind = o->kinds[i], least = 0, longest = 0;
        for (int m = ends[i]; m < ends[i + 1]; m++) {
            int j = users[m], after = changes[j] - (o->kinds[j] != kind);
            least = after < least ? after : least;
            longest = chains[j] < longest ? chains[j] : longest;
        }
        changes[i] = least;
        chains[i] = longest - cycles(kind);
    }
}

/* Runs of operations, and the values that these make. */
typedef struct {
    const int *neutral;
    int *heads, *operands, (*made)[2];
    int runs, written, used;
} Runs;

static void operands_as(const Operations *o, int i, int kind, const int *neutral, int *operands)
{
    const int *own = o->operands + o->begins[i];
    if (o->kinds[i] == kind) {
        for (int k = 0; k < OPERANDS[kind]; k++)
            operands[k] = own[k];
        return;
    }
    for (size_t row = 0; row < sizeof AS / sizeof *AS; row++)
        if (AS[row].one == o->kinds[i] && AS[row].other == kind)
            for (int k = 0; k < OPERANDS[kind]; k++)
                operands[k] = AS[row].operands[k] < 0 ? neutral[-1 - AS[row].operands[k]] : own[AS[row].operands[k]];
}

/* Return a kind with few ready operations, all of which `kind` can express; -1 if there is none. */
static int short_one(const Heap *ready, int kind)
{
    for (size_t row = 0; row < sizeof AS / sizeof *AS; row++)
        if (AS[row].other == kind && ready[AS[row].one].count && ready[AS[row].one].count <= FEW)
            return AS[row].one;
    return -1;
}

/* Arrange the operations in runs. The next run has the kind of the operation on which the longest sequence of other
   kinds waits. It takes all ready operations of this kind, ordered by their operands, and, given neutral numbers,
   operations that would form a short run of their own. */
static void in_runs(Room *room, const Operations *o, int values, Runs *runs)
{
    const size_t count = (size_t)o->count;
    int *ends = arrange_integers(room, count + 2, 0), *missing = arrange_integers(room, count, 0);
    int *changes = arrange_integers(room, count, 0), *chains = arrange_integers(room, count, 0);
    int *pool = arrange_integers(room, 3 * count, 0), *order = arrange_integers(room, count, 0),
        *beside = arrange_integers(room, count, 0);
    int *places = arrange_integers(room, (size_t)values, 0), *waits = arrange_integers(room, (size_t)values, 0);
    int *in_run = arrange_integers(room, (size_t)values, -1);
    Kind_run run = {0, arrange_integers(room, count, 0), arrange_integers(room, MOST_OPERANDS * count, 0),
        arrange_integers(room, MOST_OPERANDS * count, 0), arrange_integers(room, count, 0)};
    if (room->missing)
        return;
    const int *users = users_of(room, o, values, ends, missing);
    if (room->missing)
        return;
    urgency(room, o, users, ends, missing, changes, chains);
    if (room->missing)
        return;
    Heap ready[KIND_COUNT] = {{0}};
    for (int i = 0; i < o->count; i++)
        ready[o->kinds[i]].count++;
    for (int kind = 0, at = 0; kind < KIND_COUNT; kind++) {
        ready[kind].entries = (int(*)[3])pool + at;
        at += ready[kind].count;
        ready[kind].count = 0;
    }
    for (int i = 0; i < o->count; i++)
        if (!missing[i])
            arrange_push(&ready[o->kinds[i]], changes[i], chains[i], i);
    for (int k = 0; k < values; k++)
        places[k] = k;
    for (int next = values, left = o->count; left;) {
        int kind = -1, size = 0;
        for (int each = 0; each < KIND_COUNT; each++)
            if (ready[each].count && (kind < 0 || arrange_less(ready[each].entries[0], ready[kind].entries[0])))
                kind = each;
        if (kind < 0) /* The operations wait for each other. */
            return;
        run.each = OPERANDS[kind];
        for (;;) {
            int from = ready[kind].count ? kind : runs->neutral ? short_one(ready, kind) : -1, taken[3];
            if (from < 0)
                break;
            arrange_pop(&ready[from], taken);
            const int i = taken[2];
            int *operands = run.operands + size * run.each;
            operands_as(o, i, kind, runs->neutral, operands);
            run.numbers[size] = i;
            run.after[size] = 0;
            for (int k = 0; k < run.each; k++) {
                run.places[size * run.each + k] = places[operands[k]];
                if (in_run[operands[k]] == runs->runs && waits[operands[k]] >= run.after[size])
                    run.after[size] = 1 + waits[operands[k]];
            }
            for (int k = 0; k < 2; k++)
                if (o->made[i][k] >= 0) {
                    in_run[o->made[i][k]] = runs->runs;
                    waits[o->made[i][k]] = run.after[size];
                }
            order[size] = size;
            size++;
            for (int m = ends[i]; m < ends[i + 1]; m++) {
                int user = users[m];
                if (!--missing[user])
                    arrange_push(&ready[o->kinds[user]], changes[user], chains[user], user);
            }
        }
        sort(&run, order, beside, size);
        for (int k = 0; k < size; k++) {
            const int i = run.numbers[order[k]];
            for (int m = 0; m < run.each; m++)
                runs->operands[runs->used++] = run.operands[order[k] * run.each + m];
            for (int m = 0; m < 2; m++) {
                runs->made[runs->written][m] = o->made[i][m];
                if (o->made[i][m] >= 0)
                    places[o->made[i][m]] = next++;
            }
            runs->written++;
        }
        runs->heads[2 * runs->runs] = kind;
        runs->heads[2 * runs->runs++ + 1] = size;
        left -= size;
    }
}

/* Arrange operations in runs, for a binding. Each operation makes two values in `made`, -1 for none; `neutral` holds
   the values 1, -1 and -0, or is NULL; `heads` becomes the kind and length of each run. Return the number of runs, -1
   without memory. */
API int alfmu_in_runs(int count, int values, int *kinds, int *operands, int *made, const int *neutral, int *heads,
    int *operands_then, int *made_then)
{
    Room room = {0};
    Operations o = {0, 0, kinds, arrange_integers(&room, (size_t)count, 0), operands, (int(*)[2])made};
    Runs runs = {neutral, heads, operands_then, (int(*)[2])made_then, 0, 0, 0};
    for (int i = 0; !room.missing && i < count; i++)
        arrange_add(&o, kinds[i], made[2 * i], made[2 * i + 1]);
    if (!room.missing)
        in_runs(&room, &o, values, &runs);
    arrange_leave(&room);
    return room.missing ? -1 : runs.runs;
}

/* Append the operations other than sums; sines and cosines come last, joined if they have the same angle. */
static void others(Sums *f, int *slots, int *following[2], int *firsts[2], int *lasts[2])
{
    Operations *o = &f->made;
    int angles = 0;
    for (int k = 0; k < f->count; k++) {
        const int code = f->codes[k], a = f->first[k], b = f->second[k];
        if (code == SINE_COSINE_KIND) {
            const int which = a < 0, angle = which ? b : a;
            if (slots[angle] < 0)
                slots[angle] = angles++;
            const int slot = slots[angle];
            if (firsts[which][slot] < 0)
                firsts[which][slot] = k;
            else
                following[which][lasts[which][slot]] = k;
            lasts[which][slot] = k;
        } else if (code == OVER_KIND || code > SINE_COSINE_KIND) {
            o->operands[o->used] = a;
            o->operands[o->used + 1] = b;
            arrange_add(o, code, k, -1);
        }
    }
    for (int k = 0, seen = 0; k < f->count && seen < angles; k++) {
        if (f->codes[k] != SINE_COSINE_KIND)
            continue;
        const int angle = f->first[k] < 0 ? f->second[k] : f->first[k], slot = slots[angle];
        if (slot != seen)
            continue;
        seen++;
        for (int sine = firsts[0][slot], cosine = firsts[1][slot]; sine >= 0 || cosine >= 0;) {
            const int first = sine >= 0 ? sine : f->values++, second = cosine >= 0 ? cosine : f->values++;
            o->operands[o->used] = angle;
            arrange_add(o, SINE_COSINE_KIND, first, second);
            sine = sine >= 0 ? following[0][sine] : -1;
            cosine = cosine >= 0 ? following[1][cosine] : -1;
        }
    }
}

/* Arrange a function in runs, for a binding. `codes` holds the kind of each instruction (-1 if it makes nothing; a sum
   is PLUS, MINUS, NEGATIVE or PRODUCT) and `operands` two operands, -1 for none; a cosine has its angle as the second
   one. `opposite` is the index in `constants` of each constant's negative, -1 for other values. `constants` becomes the
   values of these, -1 if unused; 1, -1 and -0 come first. For the results see `alfmu_in_runs`. */
API int alfmu_arrange(int count, const int *codes, const int *operands, const int *opposite, int constant_count,
    int *constants, int *heads, int *operands_then, int *made_then)
{
    Sums form, *f = &form;
    Room *room = &f->room;
    const size_t size = (size_t)count;
    memset(f, 0, sizeof *f);
    f->count = count;
    f->codes = codes;
    f->first = operands;
    f->second = operands + count;
    f->opposite = opposite;
    f->constants = constants;
    for (int k = 0; k < constant_count; k++)
        constants[k] = k < 3 ? count + k : -1;
    f->values = count + 3;
    f->uses = arrange_integers(room, size + 3, 0);
    f->negative = arrange_integers(room, 2 * size, 0);
    f->factor = arrange_integers(room, 2 * size, 0);
    f->other = arrange_integers(room, 2 * size, 0);
    f->next = arrange_integers(room, 2 * size, -1);
    f->begin = arrange_integers(room, size + 3, -1);
    f->end = arrange_integers(room, size + 3, -1);
    f->length = arrange_integers(room, size + 3, 0);
    f->negatives = arrange_integers(room, size + 3, -1);
    f->made.kinds = arrange_integers(room, 3 * size, 0);
    f->made.begins = arrange_integers(room, 3 * size, 0);
    f->made.operands = arrange_integers(room, 15 * size + 2, 0);
    f->made.made = (int(*)[2])arrange_integers(room, 6 * size, -1);
    int *slots = arrange_integers(room, size + 3, -1), *following[2], *firsts[2], *lasts[2];
    for (int which = 0; which < 2; which++) {
        following[which] = arrange_integers(room, size, -1);
        firsts[which] = arrange_integers(room, size, -1);
        lasts[which] = arrange_integers(room, size, -1);
    }
    Runs runs = {constants, heads, operands_then, (int(*)[2])made_then, 0, 0, 0};
    if (!room->missing) {
        for (int k = 0; k < 2 * count; k++)
            if (operands[k] >= 0)
                f->uses[operands[k]]++;
        arrange_sums(f);
        without_differences(f);
    }
    if (!room->missing) {
        for (int k = 0; k < count; k++)
            if (f->length[k])
                arrange_write(f, k);
        others(f, slots, following, firsts, lasts);
        in_runs(room, &f->made, f->values, &runs);
    }
    arrange_leave(room);
    return room->missing ? -1 : runs.runs;
}
