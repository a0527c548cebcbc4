/* Reads functions of CasADi and encodes them without loops, for `alfmu.kernel.stream` and `alfmu.kernel.passes`.
   Running a scene does not need it. */

#include "arrange.h"
#include "arrange_operations.h"
#include "fmi.h"
#include "operations.h"

#define MOST_IN_RUN 65535

/* Placeholder for the number of 1.0, which is known only after all others. */
#define ONE_THEN (-2)

/* Neutral numbers, and the most operands of an instruction. */
#define NEUTRALS 3
#define MOST_TAKEN 15

/* A hash table that numbers triples. */
typedef struct {
    int (*keys)[3], *numbers, mask;
} Known;

static Known known_of(Room *room, int count)
{
    int size = 4;
    while (size < 2 * count)
        size *= 2;
    Known made = {(int(*)[3])arrange_integers(room, 3 * (size_t)size, 0), arrange_integers(room, (size_t)size, -1),
        size - 1};
    return made;
}

/* Return the number of a triple; a new one gets `number`. */
static int known_number(Known *known, int a, int b, int c, int number)
{
    unsigned at = (unsigned)a * 2654435761u ^ (unsigned)b * 2246822519u ^ (unsigned)c * 3266489917u;
    for (at ^= at >> 15;; at++) {
        const int slot = (int)(at & (unsigned)known->mask), *key = known->keys[slot];
        if (known->numbers[slot] < 0) {
            const int own[3] = {a, b, c};
            memcpy(known->keys[slot], own, sizeof own);
            return known->numbers[slot] = number;
        }
        if (key[0] == a && key[1] == b && key[2] == c)
            return known->numbers[slot];
    }
}

static int is_binary(int role)
{
    return role == BINARY_ROLE || role == COPYSIGN_ROLE;
}

/* Read CasADi's listing of a function, one instruction a line, into `atoms` of `alfmu_instructions`, without the values
   of constants. The form of a line is a hash of all but its addresses and places, 0 for constants; `forms` has those
   of `known` operations, and room for one more: where another form is found, write it there and return the number of
   this instruction. Return `count` when all are read, -1 if the text is no such listing. */
API int alfmu_listing(const char *text, int count, int (*atoms)[4], int known, uint64_t (*forms)[2])
{
    for (int k = 0; k < count; k++) {
        const int writes = *text == 'o';
        unsigned numbers[3] = {0};
        int found = 0, which = 0;
        uint64_t form = 14695981039346656037u;
        for (; *text && *text != '\n'; text++) {
            form = (form ^ (unsigned char)*text) * 1099511628211u;
            if (*text != '@' && *text != '[')
                continue;
            if (found == 3)
                return -1;
            for (; text[1] >= '0' && text[1] <= '9'; text++)
                numbers[found] = 10 * numbers[found] + (unsigned)(text[1] - '0');
            found++;
        }
        if (!found)
            return -1;
        text += *text == '\n';
        form = found == 1 ? 0 : form;
        while (which < known && forms[which][0] != form)
            which++;
        if (which == known) {
            forms[known][0] = form;
            return k;
        }
        atoms[k][0] = (int)forms[which][1];
        atoms[k][1] = (int)numbers[0];
        atoms[k][2] = (int)numbers[writes ? 2 : 1];
        atoms[k][3] = (int)numbers[writes ? 1 : 2];
    }
    return count;
}

/* Read the instructions of a function; leave out operations that repeat an earlier one on the same values. Each atom of
   CasADi has an operation and three numbers: addresses, places or a constant. `roles` has the roles of `OPERATIONS`
   operations. The arrays of two rows have `count` columns. Return the number of instructions; -1 if these numbers are
   invalid, or without memory. */
API int alfmu_instructions(int count, const int (*atoms)[4], const int *roles, int64_t *code, int64_t *operands,
    int64_t *places, double *constants)
{
    Room room = {0};
    int *writers = arrange_integers(&room, (size_t)count, -1), kept = 0;
    Known known = known_of(&room, count);
    for (int k = 0; !room.missing && kept >= 0 && k < count; k++) {
        const int *atom = atoms[k], role = atom[0] >= 0 && atom[0] < OPERATIONS ? roles[atom[0]] : -1;
        const int writes = role != OUTPUT_ROLE, leaf = role == INPUT_ROLE || role == CONSTANT_ROLE;
        const int reads = leaf ? 0 : 1 + is_binary(role);
        int from[2] = {-1, -1}, good = role >= 0 && (!writes || (atom[1] >= 0 && atom[1] < count));
        for (int j = 0; good && j < reads; j++) {
            good = atom[2 + j] >= 0 && atom[2 + j] < count && writers[atom[2 + j]] >= 0;
            from[j] = good ? writers[atom[2 + j]] : -1;
        }
        const int own = good && writes && !leaf ? known_number(&known, atom[0], from[0], from[1], kept) : kept;
        if (good && writes)
            writers[atom[1]] = own;
        if (good && own == kept) {
            code[kept] = atom[0];
            for (int j = 0; j < 2; j++) {
                operands[j * (ptrdiff_t)count + kept] = from[j];
                places[j * (ptrdiff_t)count + kept] =
                    role == INPUT_ROLE ? atom[2 + j] : role == OUTPUT_ROLE ? atom[1 + 2 * j] : -1;
            }
            constants[kept] = 0.0;
            if (role == CONSTANT_ROLE)
                memcpy(constants + kept, atom + 2, sizeof *constants);
            kept++;
        }
        kept = good ? kept : -1;
    }
    arrange_leave(&room);
    return room.missing ? -1 : kept;
}

/* A function while it is encoded: its instructions, and those for `alfmu_arrange`. There arguments and constants come
   before the first operation that uses them, and a last instruction uses each value that is a result. */
typedef struct {
    Room room;
    int count, then, entries;
    const int64_t *code, *first, *second, *which, *entry;
    const int *roles;
    /* `numbers`: number of each instruction for `alfmu_arrange`; `slots`: of arguments their entry, of constants their
       index after all entries; `leaf_numbers`: number of each slot, -1 if no operation uses it. */
    int *numbers, *slots, *leaf_numbers;
    /* Instructions for `alfmu_arrange`. */
    int *codes, *operands, *slots_then;
    Known known;
    double *constants;
    int constant_count;
    /* Runs of `alfmu_arrange`; address of each value: a constant from -1 down, an argument or a value from 0 on. */
    int runs, *heads, *operands_then, *made, *at;
} Straight;

static int role_of(const Straight *s, int64_t k)
{
    return s->roles[s->code[k]];
}

static int is_leaf(const Straight *s, int64_t k)
{
    return role_of(s, k) == INPUT_ROLE || role_of(s, k) == CONSTANT_ROLE;
}

/* Return the number of an operand; copying a number's own sign is no operation. */
static int operand_number(const Straight *s, int64_t k)
{
    if (role_of(s, k) == COPYSIGN_ROLE && s->first[k] == s->second[k])
        k = s->first[k];
    return is_leaf(s, k) ? s->leaf_numbers[s->slots[k]] : s->numbers[k];
}

static void append(Straight *s, int code, int first, int second, int slot)
{
    s->codes[s->then] = code;
    s->operands[2 * s->then] = first;
    s->operands[2 * s->then + 1] = second;
    s->slots_then[s->then++] = slot;
}

/* Append an operation for `alfmu_arrange`, after its arguments and constants that are new. */
static void add_operation(Straight *s, int k, const int *kinds)
{
    const int64_t from[2] = {s->first[k], s->second[k]};
    for (int j = 0; j < 2; j++)
        if (from[j] >= 0 && is_leaf(s, from[j]) && s->leaf_numbers[s->slots[from[j]]] < 0) {
            s->leaf_numbers[s->slots[from[j]]] = s->then;
            append(s, -1, -1, -1, s->slots[from[j]]);
        }
    const int first = operand_number(s, from[0]), second = from[1] < 0 ? -1 : operand_number(s, from[1]);
    const int role = role_of(s, k), same = role == COPYSIGN_ROLE && from[0] == from[1];
    s->numbers[k] = s->then;
    append(s, same ? -1 : kinds[s->code[k]], role == INVERSE_ROLE ? ONE_THEN : role == COSINE_ROLE ? -1 : first,
        role == DOUBLED_ROLE || role == INVERSE_ROLE || role == COSINE_ROLE ? first : second, -1);
}

static int bits_number(Known *known, double value, int number)
{
    int bits[2];
    memcpy(bits, &value, sizeof bits);
    return known_number(known, bits[0], bits[1], 0, number);
}

/* Return the index of a constant, which is added if new. */
static int constant_index(Straight *s, double value)
{
    const int index = bits_number(&s->known, value, s->constant_count);
    if (index == s->constant_count)
        s->constants[s->constant_count++] = value;
    return index;
}

/* Find the slots of arguments and of used constants. */
static void find_slots(Straight *s, const double *constants, const int *arguments)
{
    int *used = arrange_integers(&s->room, (size_t)s->count, 0);
    if (s->room.missing)
        return;
    for (int k = 0; k < s->count; k++) {
        if (s->first[k] >= 0)
            used[s->first[k]] = 1;
        if (s->second[k] >= 0)
            used[s->second[k]] = 1;
    }
    constant_index(s, 0.0); /* of results that no operation writes */
    for (int k = 0; k < s->count; k++) {
        if (role_of(s, k) == INPUT_ROLE)
            s->slots[k] = arguments[s->which[k]] + (int)s->entry[k];
        else if (role_of(s, k) == CONSTANT_ROLE && used[k])
            s->slots[k] = s->entries + constant_index(s, constants[k]);
    }
}

/* Return a constant that arranging may use: 1, -1 or -0, or the negative of a constant of the function. */
static double opposite_of(const Straight *s, int index)
{
    static const double NEUTRAL[] = {1.0, -1.0, -0.0};
    return index < NEUTRALS ? NEUTRAL[index] : -s->constants[index - NEUTRALS];
}

static int slot_address(const Straight *s, int slot)
{
    return slot < s->entries ? slot : s->entries - 1 - slot;
}

static int64_t address_of(int at, int64_t behind)
{
    return at < 0 ? -1 - at - behind : at + behind;
}

/* Sort the constants that arranging uses by their new numbers. */
static int in_order(const int *values, int count, int *order)
{
    int found = 0;
    for (int k = 0; k < count; k++)
        if (values[k] >= 0) {
            int at = found++;
            for (; at && values[order[at - 1]] > values[k]; at--)
                order[at] = order[at - 1];
            order[at] = k;
        }
    return found;
}

/* Arrange the operations in runs, and find the addresses of all values; return the number of values made. */
static int arrange(Straight *s)
{
    Room *room = &s->room;
    const size_t then = (size_t)s->then;
    int *operands = arrange_integers(room, 2 * then, -1), *opposites = arrange_integers(room, then, -1);
    int *values = arrange_integers(room, then + NEUTRALS, -1), *order = arrange_integers(room, then + NEUTRALS, 0);
    int *taken = arrange_integers(room, then + NEUTRALS, 0), count = 0, most = s->then + NEUTRALS, made = 0, found = 0;
    s->heads = arrange_integers(room, 6 * then, 0);
    s->operands_then = arrange_integers(room, MOST_TAKEN * then + 2, 0);
    s->made = arrange_integers(room, 6 * then, -1);
    Known known = known_of(room, s->then + NEUTRALS);
    if (room->missing)
        return 0;
    for (; count < NEUTRALS; count++)
        taken[bits_number(&known, opposite_of(s, count), count)] = count;
    for (int k = 0; k < s->then; k++) {
        for (int j = 0; j < 2; j++)
            operands[j * s->then + k] = s->operands[2 * k + j] == ONE_THEN ? s->then : s->operands[2 * k + j];
        if (s->slots_then[k] >= s->entries) {
            const int index = NEUTRALS + s->slots_then[k] - s->entries;
            opposites[k] = bits_number(&known, opposite_of(s, index), count);
            if (opposites[k] == count)
                taken[count++] = index;
        }
    }
    s->runs = alfmu_arrange(
        s->then, s->codes, operands, opposites, count, values, s->heads, s->operands_then, s->made);
    for (int k = 0; k < s->runs; k++)
        made += 2 * s->heads[2 * k + 1];
    for (int k = 0; k < made; k++)
        most = s->made[k] >= most ? s->made[k] + 1 : most;
    count = in_order(values, count, order);
    for (int k = 0; k < count; k++)
        most = values[order[k]] >= most ? values[order[k]] + 1 : most;
    s->at = arrange_integers(room, (size_t)most, 0);
    if (s->runs < 0 || room->missing)
        return 0;
    for (int k = 0; k < s->then; k++)
        if (s->slots_then[k] >= 0)
            s->at[k] = slot_address(s, s->slots_then[k]);
    for (int k = 0; k < count; k++)
        s->at[values[order[k]]] = -1 - constant_index(s, opposite_of(s, taken[order[k]]));
    for (int k = 0; k < made; k++)
        if (s->made[k] >= 0)
            s->at[s->made[k]] = s->entries + found++;
    return found;
}

/* Write the words of the runs, each of at most MOST_IN_RUN operations. */
static int write_words(const Straight *s, int64_t behind, int64_t *words)
{
    int count = 0, taken = 0;
    for (int k = 0; k < s->runs; k++)
        for (int left = s->heads[2 * k + 1], part; left; left -= part) {
            part = left < MOST_IN_RUN ? left : MOST_IN_RUN;
            words[count++] = s->heads[2 * k];
            words[count++] = part;
            for (int end = taken + part * OPERANDS[s->heads[2 * k]]; taken < end; taken++)
                words[count++] = address_of(s->at[s->operands_then[taken]], behind);
        }
    return count;
}

/* Write the rows of results, in the order in which their values are made. */
static int write_rows(const Straight *s, const int *results, const int *firsts, const int *nexts, int64_t behind,
    int64_t (*rows)[2])
{
    int count = 0;
    for (int k = 0; k < s->count; k++) {
        const int alone = role_of(s, k) == OUTPUT_ROLE && is_leaf(s, s->first[k]);
        for (int m = alone ? k : is_leaf(s, k) ? -1 : firsts[k]; m >= 0; m = alone ? -1 : nexts[m]) {
            const int at = alone ? slot_address(s, s->slots[s->first[k]]) : s->at[operand_number(s, k)];
            rows[count][0] = results[s->which[m]] + s->entry[m];
            rows[count++][1] = address_of(at, behind);
        }
    }
    return count;
}

/* Encode a function from `alfmu_instructions` as straight code: the words of its runs, its constants, and rows (entry
   of the results, address). Addresses of constants begin at -behind, those of arguments and then of values at `behind`.
   `kinds` has the kind of each CasADi operation, `arguments` and `results` the first entry of each argument and result;
   `entries` is the number of entries of all arguments. `sizes` becomes the numbers of words, constants, values and
   rows. Return -1 without memory. */
API int alfmu_straight(int count, const int64_t *code, const int64_t *operands, const int64_t *places,
    const double *given, const int *roles, const int *kinds, const int *arguments, int entries, const int *results,
    int64_t behind, int64_t *words, double *constants, int64_t (*rows)[2], int *sizes)
{
    Straight straight, *s = &straight;
    Room *room = &s->room;
    const size_t size = (size_t)count;
    memset(s, 0, sizeof *s);
    s->count = count;
    s->entries = entries;
    s->code = code;
    s->first = operands;
    s->second = operands + count;
    s->which = places;
    s->entry = places + count;
    s->roles = roles;
    s->constants = constants;
    s->numbers = arrange_integers(room, size, -1);
    s->slots = arrange_integers(room, size, -1);
    s->leaf_numbers = arrange_integers(room, size + (size_t)entries + 1, -1);
    s->codes = arrange_integers(room, 2 * size, -1);
    s->operands = arrange_integers(room, 4 * size, -1);
    s->slots_then = arrange_integers(room, 2 * size, -1);
    s->known = known_of(room, 2 * count + NEUTRALS + 1);
    int *firsts = arrange_integers(room, size, -1), *nexts = arrange_integers(room, size, -1); /* results of a value */
    find_slots(s, given, arguments);
    if (!room->missing) {
        for (int k = 0; k < count; k++)
            if (!is_leaf(s, k) && role_of(s, k) != OUTPUT_ROLE)
                add_operation(s, k, kinds);
        for (int k = count; k--;)
            if (role_of(s, k) == OUTPUT_ROLE) {
                nexts[k] = firsts[s->first[k]];
                firsts[s->first[k]] = k;
            }
        for (int k = 0; k < count; k++)
            if (firsts[k] >= 0 && !is_leaf(s, k))
                append(s, -1, operand_number(s, k), -1, -1);
        sizes[2] = arrange(s);
    }
    const int done = !room->missing && s->runs >= 0;
    if (done) {
        sizes[0] = write_words(s, behind, words);
        sizes[1] = s->constant_count;
        sizes[3] = write_rows(s, results, firsts, nexts, behind, rows);
    }
    arrange_leave(room);
    return done ? 0 : -1;
}
