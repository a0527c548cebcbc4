#include "scene_functions.h"

#include <stdarg.h>

#include "instance.h"
#include "operations.h"
#include "scene.h"
#include "scene_reader.h"
#include "scene_sizes.h"

/* State of the check of a function: runs must stay within their list and use known values only. */
typedef struct {
    const Function *f;
    size_t at;
    int64_t known; /* number of places known so far */
    Reader *reader;
} Checked;

static int64_t word_at(const Checked *c, size_t at)
{
    return c->f->narrow ? (int64_t)c->f->narrow[at] : (int64_t)c->f->wide[at];
}

static int operand_count(int64_t kind)
{
    static const unsigned char counts[] = {OPERAND_COUNTS};
    return counts[kind];
}

/* Return whether an operand is known in each pass of a loop; each pass adds `more` values. */
static int are_within_passes(int64_t first, int64_t step, int64_t known, int64_t passes, int64_t more)
{
    const int64_t last = first + (passes - 1) * step;
    /* Both sides are linear in the pass, so that its first and last value suffice. */
    return first >= 0 && last >= 0 && first < known && last < known + (passes - 1) * more;
}

/* Check the operands of an operation in all passes of a loop. */
static void check_passes(Checked *c, int64_t kind, int64_t known, int64_t passes, int64_t more)
{
    for (int k = 0; k < operand_count(kind); k++, c->at += 2)
        if (!are_within_passes(word_at(c, c->at), word_at(c, c->at + 1), known, passes, more))
            reader_spoil(c->reader, "a loop reads a value before it is computed");
}

/* Check the body of a loop, which ends at `end`. */
static void check_body(Checked *c, size_t end, int64_t passes, int64_t values)
{
    int64_t made = 0;
    while (end - c->at >= 2 && !c->reader->bad) {
        const int64_t kind = word_at(c, c->at);
        int64_t count = word_at(c, c->at + 1);
        c->at += 2;
        if (kind < 0 || kind >= KIND_COUNT) {
            reader_spoil(c->reader, "there is no operation %d in a loop", (int)kind);
            return;
        }
        if (count < 0 || (uint64_t)count > (end - c->at) / (2 * (unsigned)operand_count(kind))) {
            reader_spoil(c->reader, "a loop of a function is damaged");
            return;
        }
        for (; count > 0; count--, made += VALUES_OF(kind))
            check_passes(c, kind, c->known + made, passes, values);
    }
    if (c->at != end || made != values)
        reader_spoil(c->reader, "a loop of a function is damaged");
}

/* Check loops, which only wide functions have. Return 0 if there is none here. */
static int check_loop(Checked *c, int64_t kind, int64_t count)
{
    const size_t left = c->f->words - c->at;
    if (!c->f->wide || (kind != LOOP_KIND && kind != EACH_KIND && kind != GATHER_KIND))
        return 0;
    if (count < 1 || left < 2) {
        reader_spoil(c->reader, "a loop of a function is damaged");
    } else if (kind == GATHER_KIND) {
        if ((uint64_t)count > left) {
            reader_spoil(c->reader, "a function is damaged");
            return 1;
        }
        for (int64_t k = 0; k < count; k++, c->at++)
            if (word_at(c, c->at) < 0 || word_at(c, c->at) >= c->known)
                reader_spoil(c->reader, "a function copies a value before it is computed");
        c->known += count;
    } else if (kind == EACH_KIND) {
        const int64_t each = word_at(c, c->at);
        if (each < 0 || each >= KIND_COUNT || left - 1 < 2 * (size_t)operand_count(each)) {
            reader_spoil(c->reader, "a loop of a function is damaged");
            return 1;
        }
        c->at++;
        check_passes(c, each, c->known, count, 0);
        c->known += count * VALUES_OF(each);
    } else {
        const int64_t values = word_at(c, c->at), body = word_at(c, c->at + 1);
        if (values < 1 || values > MOST_NUMBERS / count || body < 0 || (uint64_t)body > left - 2) {
            reader_spoil(c->reader, "a loop of a function is damaged");
            return 1;
        }
        c->at += 2;
        check_body(c, c->at + (size_t)body, count, values);
        c->known += count * values;
    }
    if (c->known > MOST_NUMBERS)
        reader_spoil(c->reader, "a function is too long");
    return 1;
}

static void check_function(Reader *r, Function *f)
{
    Checked c = {f, 0, r->scene->constant_count, r};
    for (int k = 0; k < f->inputs; k++)
        c.known += f->lengths[k];
    while (c.at < f->words && !r->bad) {
        int64_t operation, count;
        int operands;
        if (f->words - c.at < 2) {
            reader_spoil(r, "a function is damaged");
            return;
        }
        operation = word_at(&c, c.at);
        count = word_at(&c, c.at + 1);
        c.at += f->narrow ? NARROW_HEAD : 2;
        if (check_loop(&c, operation, count))
            continue;
        if (operation < 0 || operation >= KIND_COUNT) {
            reader_spoil(r, "there is no operation %d", (int)operation);
            return;
        }
        operands = operand_count(operation);
        if (count < 0 || (uint64_t)count > (f->words - c.at) / (unsigned)operands) {
            reader_spoil(r, "a function is damaged");
            return;
        }
        for (; count > 0; count--, c.known += VALUES_OF(operation))
            for (int k = 0; k < operands; k++, c.at++)
                if (word_at(&c, c.at) < 0 || word_at(&c, c.at) >= c.known)
                    reader_spoil(r, "an operation reads a value before it is computed");
    }
    for (size_t k = 0; k < (size_t)f->results && !r->bad; k++)
        if (word_at(&c, f->words + k) < 0 || word_at(&c, f->words + k) >= c.known)
            reader_spoil(r, "a function returns a value that it does not compute");
    if (c.known > MOST_NUMBERS) {
        reader_spoil(r, "a function is too long");
        return;
    }
    f->registers = (int)c.known;
    if (f->registers > r->scene->registers)
        r->scene->registers = f->registers;
}

/* Read places as differences; write them `step` words apart. Sums from `first` on count back from `end`. */
static void read_places(Reader *r, size_t count, uint32_t first, uint32_t end, uint16_t *places, size_t step)
{
    uint16_t sum = 0;
    for (size_t k = 0; k < count; k++) {
        sum = (uint16_t)(sum + (uint32_t)reader_bare(r));
        places[k * step] = (uint16_t)(sum < first ? sum : sum + end);
    }
}

/* Read words of a function with 16-bit places, and these of its results. The file holds the kind and length of each
   run, then its operands, all first ones before the second ones. */
static void read_narrow(Reader *r, Function *f, int64_t first, int64_t results)
{
    const size_t words = reader_length(r);
    uint16_t *made = reader_has(r, words / 2 + (size_t)results, 1)
        ? reader_alloc(r, words + (size_t)results + 1, sizeof *made)
        : NULL;
    uint32_t end = (uint32_t)first;
    if (!made)
        return;
    for (size_t at = 0; at < words;) {
        const int32_t kind = reader_bare(r), count = reader_bare(r);
        const unsigned each = reader_check_between(kind, 0, KIND_COUNT) ? (unsigned)operand_count(kind) : 0;
        const size_t left = words - at;
        if (!each || left < NARROW_HEAD || !reader_check_between(count, 0, 1 << 16)
            || (unsigned)count > (left - NARROW_HEAD) / each) {
            reader_spoil(r, "a function is damaged");
            return;
        }
        made[at++] = (uint16_t)kind;
        made[at++] = (uint16_t)count;
        made[at++] = (uint16_t)end;
        end += (unsigned)count * VALUES_OF(kind);
        for (unsigned j = 0; j < each; j++)
            read_places(r, (unsigned)count, (uint32_t)first, end, made + at + j, each);
        at += (unsigned)count * each;
    }
    read_places(r, (size_t)results, (uint32_t)first, end, made + words, 1);
    f->narrow = made;
    f->words = words;
    f->results = (int)results;
}

static void read_function(Reader *r, Function *f)
{
    size_t inputs = 0, outputs = 0;
    const int32_t *in = reader_integers(r, -1, &inputs), *out = reader_integers(r, -1, &outputs);
    const int wide = reader_integer(r);
    int32_t *lengths;
    int64_t all = 0, known = r->scene->constant_count;
    if (inputs + outputs > MOST_ARGUMENTS)
        reader_spoil(r, "a function has %zu arguments and results", inputs + outputs);
    if (r->bad || !(lengths = reader_alloc(r, inputs + outputs + 1, sizeof *lengths)))
        return;
    memcpy(lengths, in, inputs * sizeof *in);
    memcpy(lengths + inputs, out, outputs * sizeof *out);
    for (size_t k = 0; k < inputs + outputs; k++) {
        if (lengths[k] < 0 || lengths[k] > MOST_NUMBERS / MOST_ARGUMENTS)
            reader_spoil(r, "an argument of a function has %d numbers", (int)lengths[k]);
        *(k < inputs ? &known : &all) += lengths[k];
    }
    if ((r->results += all) > MOST_RESULTS)
        reader_spoil(r, "its functions return too many numbers");
    f->inputs = (int)inputs;
    f->outputs = (int)outputs;
    f->lengths = lengths;
    /* The words are followed by the places of results. */
    if (wide) {
        size_t words = 0, rows = 0;
        int64_t spare = 2 * all; /* room for two places per entry */
        const int32_t *first = reader_integers(r, -1, &words), *then = reader_integers(r, -1, &rows);
        int32_t *both = r->bad ? NULL : reader_alloc(r, words + (size_t)all + 1, sizeof *both);
        if (!both)
            return;
        memcpy(both, first, words * sizeof *both);
        for (int64_t k = 0; k < all; k++)
            both[words + (size_t)k] = -1;
        /* Each row: count, first entry and step between entries, first place and step between places. */
        for (const int32_t *row = then; row + 5 <= then + rows; row += 5) {
            const int64_t count = row[0], last = row[1] + (count - 1) * row[2];
            if (count < 1 || (spare -= count) < 0 || row[1] < 0 || row[1] >= all || last < 0 || last >= all) {
                reader_spoil(r, "the results of a function are damaged");
                return;
            }
            for (int64_t each = 0; each < count; each++)
                both[words + (size_t)(row[1] + each * row[2])] = (int32_t)(row[3] + each * row[4]);
        }
        f->wide = both;
        f->words = words;
        f->results = (int)all;
    } else {
        read_narrow(r, f, known, all);
    }
    check_function(r, f);
}

/* Check the arguments and results of a function that the runtime calls. */
void function_is_shaped(Reader *r, const char *name, int which, int needed, int inputs, int outputs, ...)
{
    const Scene *s = r->scene;
    const Function *f;
    va_list lengths;
    if (r->bad)
        return;
    if (which < 0 || which >= s->function_count) {
        if (which != -1 || needed)
            reader_spoil(r, "there is no function %s", name);
        return;
    }
    f = s->functions + which;
    if (f->inputs != inputs || f->outputs != outputs) {
        reader_spoil(r, "the function %s has %d arguments and %d results", name, f->inputs, f->outputs);
        return;
    }
    va_start(lengths, outputs);
    for (int k = 0; k < inputs + outputs; k++) {
        const int needed_length = va_arg(lengths, int);
        if (f->lengths[k] != needed_length)
            reader_spoil(r, "the function %s has %d numbers instead of %d", name, f->lengths[k], needed_length);
    }
    va_end(lengths);
}

void functions_read(Reader *r)
{
    Scene *s = r->scene;
    const int n = s->n, l = s->l, P = s->own + s->held, K = scene_settings_length(s), ties = s->ties;
    Function *made;
    size_t count;
    s->constants = reader_reals(r, &count);
    s->constant_count = (int)count;
    s->registers = s->constant_count;
    count = reader_length(r);
    made = reader_has(r, count, 20) ? reader_alloc(r, count + 1, sizeof *made) : NULL;
    for (size_t k = 0; k < count && !r->bad; k++)
        read_function(r, made + k);
    s->functions = made;
    s->function_count = (int)count;
    function_is_shaped(
        r, "dynamics", s->dynamics, 1, 5, 4, n, n, scene_driven(s), P, 1, s->mass.entries, s->constraint.entries, n, l);
    function_is_shaped(
        r, "constraints", s->constraints, 1, 3, 4, n, n, P, s->mass.entries, s->constraint.entries, l, l);
    function_is_shaped(r, "energy", s->energy, 1, 3, 2, n, n, P, 1, 1);
    function_is_shaped(
        r, "closure", s->closure, 1, 3, 4, n, P, s->starts, s->gaps.entries, s->tie_rows.entries, l, ties);
    function_is_shaped(r, "guesses", s->guesses, 1, 3, 2, P, s->starts, s->starts, n, n);
    function_is_shaped(r, "displacements", s->displacements, s->held > 0, 2, 1, n, P, s->held);
    function_is_shaped(r, "sliding", s->sliding, s->frictions > 0, 3, 1, n, n, P, s->frictions);
    function_is_shaped(
        r, "breaks", s->breaks, s->break_count > 0, 4, 1, 1, s->inputs, s->inputs, P, 2 * s->break_count);
    function_is_shaped(r, "state_rates", s->state_rates, scene_states(s) > 0 && s->exchange >= 0, 5, 1, n, n,
        scene_driven(s), P, 1, scene_states(s));
    function_is_shaped(r, "pivots", s->pivots, l > 0, 3, 4, n, P, K, n, n, n, 1);
    function_is_shaped(r, "margin", s->margin, 0, 3, 1, n, P, K, 1);
    function_is_shaped(r, "place", s->place, l > 0, 3, 1, n, P, K, n);
    function_is_shaped(r, "bring", s->bring, l > 0, 5, 2, n, n, n, P, K, n, n);
    function_is_shaped(r, "settle", s->settle, l > 0, 4, 3, n, n, P, K, n, 1, 2);
}
