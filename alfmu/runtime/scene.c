/* Loads a scene from its file, and checks everything in it once, so that nothing has to be checked while it runs.

   A file is `ALFMU\r\n\x1a`, the version, the length of the whole, a check sum of what follows it, an identity, and the body;
   all numbers are little-endian. */

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "alfmu.h"
#include "operations.h"

#define HEAD 64 /* bytes before the body */
#define DEEPEST 16 /* choices and loops within each other */
#define MOST_NUMBERS (1 << 28) /* in the memory or the registers of an instance */
#define MOST_UNKNOWNS 10000 /* of a dense system */
#define MOST_RESULTS (1 << 26) /* of all functions */

typedef struct {
    const unsigned char *at, *end;
    Scene *scene;
    char *why;
    size_t why_size;
    int bad;
    int64_t results; /* of all functions so far */
} Reader;

struct Block {
    struct Block *next;
};

static void spoil(Reader *r, const char *format, ...)
{
    va_list arguments;
    if (r->bad)
        return;
    r->bad = 1;
    va_start(arguments, format);
    vsnprintf(r->why, r->why_size, format, arguments);
    va_end(arguments);
}

/* Memory of the scene, zero; never NULL without `bad`. */
static void *room(Reader *r, size_t count, size_t size)
{
    struct Block *block;
    if (r->bad || count > SIZE_MAX / 2 / size || !(block = calloc(1, sizeof(double) + count * size))) {
        spoil(r, "there is no memory for it");
        return NULL;
    }
    block->next = r->scene->blocks;
    r->scene->blocks = block;
    return (char *)block + sizeof(double);
}

static uint64_t little(const unsigned char *at, int bytes)
{
    uint64_t value = 0;
    for (int k = bytes; k--;)
        value = value << 8 | at[k];
    return value;
}

/* Whether there can be so many that have at least so many bytes each; what is not there takes no memory. */
static int enough(Reader *r, size_t count, size_t bytes)
{
    if (count > (size_t)(r->end - r->at) / bytes)
        spoil(r, "it ends too early");
    return !r->bad;
}

/* The next bytes; NULL where there are fewer. */
static const unsigned char *taken(Reader *r, size_t count, size_t size)
{
    const unsigned char *at = r->at;
    if (r->bad || count > (size_t)(r->end - at) / size) {
        spoil(r, "it ends too early");
        return NULL;
    }
    r->at += count * size;
    return at;
}

static int32_t integer(Reader *r)
{
    const unsigned char *at = taken(r, 1, 4);
    return at ? (int32_t)(uint32_t)little(at, 4) : 0;
}

static double real(Reader *r)
{
    const unsigned char *at = taken(r, 1, 8);
    const uint64_t bits = at ? little(at, 8) : 0;
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static size_t length(Reader *r)
{
    const int32_t count = integer(r);
    if (count < 0)
        spoil(r, "a list has %d entries", (int)count);
    return r->bad ? 0 : (size_t)count;
}

static const char *text(Reader *r)
{
    const size_t count = length(r);
    const unsigned char *at = taken(r, count, 1);
    char *made = at ? room(r, count + 1, 1) : NULL;
    if (!made)
        return "";
    memcpy(made, at, count);
    return made;
}

/* Integers of 4 bytes, and how many; `count` is what there have to be, or -1. */
static int32_t *integers(Reader *r, int count, size_t *found)
{
    const size_t size = length(r);
    const unsigned char *at = taken(r, size, 4);
    int32_t *made = at ? room(r, size + 1, sizeof *made) : NULL;
    if (count >= 0 && size != (size_t)count)
        spoil(r, "a list has %zu entries in place of %d", size, count);
    if (!made || r->bad)
        return NULL;
    for (size_t k = 0; k < size; k++)
        made[k] = (int32_t)(uint32_t)little(at + 4 * k, 4);
    if (found)
        *found = size;
    return made;
}

/* Integers of 2 bytes, low bytes before high ones. */
static uint16_t *narrow_integers(Reader *r, size_t *found)
{
    const size_t size = length(r);
    const unsigned char *at = taken(r, size, 2);
    uint16_t *made = at ? room(r, size + 1, sizeof *made) : NULL;
    if (!made)
        return NULL;
    for (size_t k = 0; k < size; k++)
        made[k] = (uint16_t)(at[k] + 256u * at[size + k]);
    *found = size;
    return made;
}

static double *reals(Reader *r, size_t *found)
{
    const size_t size = length(r);
    const unsigned char *at = taken(r, size, 8);
    double *made = at ? room(r, size + 1, sizeof *made) : NULL;
    if (!made)
        return NULL;
    for (size_t k = 0; k < size; k++) {
        const uint64_t bits = little(at + 8 * k, 8);
        memcpy(made + k, &bits, sizeof bits);
    }
    *found = size;
    return made;
}

/* Integers that index something: each from `least` to below `end`. */
static const int *places(Reader *r, int count, int least, int end, const char *what)
{
    const int32_t *made = integers(r, count, NULL);
    for (int k = 0; made && k < count; k++)
        if (made[k] < least || made[k] >= end)
            spoil(r, "%s %d is %d", what, k, (int)made[k]);
    return made;
}

/* Tables ----------------------------------------------------------------------------------------------------------- */

static int between(int value, int least, int end)
{
    return value >= least && value < end;
}

/* Numbers of the scene; what is counted is checked here, so that sums of counts do not overflow. */
static void numbers(Reader *r)
{
    Scene *s = r->scene;
#define READ(name) s->name = integer(r);
    SCENE_NUMBERS(READ)
#undef READ
#define READ(name) s->name = real(r);
    SCENE_REALS(READ)
#undef READ
#define COUNTED(name) \
    if (!between(s->name, 0, 1 << 22)) \
        spoil(r, "the number of " #name " is %d", s->name);
    SCENE_COUNTS(COUNTED)
#undef COUNTED
    if (r->bad)
        return;
    if (!between(s->work, 0, 1 << 25) || !between(s->time, s->work + 1, s->work + (1 << 22)))
        spoil(r, "its state contradicts itself");
    else if (s->own + 2 * s->starts + s->compliances + states_of(s) + s->solver != s->parameters || s->n < 1
        || (s->compliances != 0 && s->compliances != s->l) || s->event_count > s->outputs)
        spoil(r, "its counts contradict each other");
#define REFERENCE(name) \
    if (!r->bad && !between(s->name, s->own + 2 * s->starts + s->compliances + states_of(s), s->parameters)) \
        spoil(r, #name " has the reference %d", s->name);
    SCENE_REFERENCES(REFERENCE)
#undef REFERENCE
    if (!between(s->branch, 0, s->choices) || !between(s->method_choice, 0, s->choices)
        || !between(s->formulation, 0, s->choices) || s->choices != CHOICES)
        spoil(r, "its choices contradict each other");
    if (s->brakes && s->l > 10000)
        spoil(r, "it has %d constraints that would brake", s->l);
    if (!between(s->method, 0, 3) || s->freedom > s->n)
        spoil(r, "its method contradicts itself");
}

static void variable(Reader *r, int kind, int k, Variable *made)
{
    const int type = (made->name = text(r), made->unit = text(r), integer(r));
    made->type = (Type)type;
    made->kind = (Kind)kind;
    made->instant = integer(r) != 0;
    made->start = real(r);
    made->minimum = real(r);
    made->maximum = real(r);
    if (!between(type, REAL, STRING + 1) || (type == STRING) != (kind == CHOICE) || (type == BOOLEAN) != (kind == SWITCH))
        spoil(r, "variable %d has the type %d", k, type);
}

static void variables(Reader *r)
{
    Scene *s = r->scene;
    const int kinds[] = {s->parameters, s->choices, s->inputs, s->switches, s->outputs}, count = variable_count(s);
    Variable *made = enough(r, (size_t)count, 40) ? room(r, (size_t)count + 1, sizeof *made) : NULL;
    int k = 0;
    for (int kind = 0; kind < 5; kind++)
        for (int each = 0; each < kinds[kind] && !r->bad; each++, k++)
            variable(r, kind, k, made + k);
    s->variables = made;
}

static void choices(Reader *r)
{
    Scene *s = r->scene;
    Choice *made = enough(r, (size_t)s->choices, 8) ? room(r, (size_t)s->choices + 1, sizeof *made) : NULL;
    for (int k = 0; k < s->choices && !r->bad; k++) {
        const char **values;
        made[k].start = integer(r);
        made[k].count = (int)length(r);
        if (!between(made[k].count, 1, 1000) || !between(made[k].start, 0, made[k].count))
            spoil(r, "choice %d has %d values", k, made[k].count);
        made[k].values = values = room(r, (size_t)made[k].count, sizeof *values);
        for (int each = 0; !r->bad && each < made[k].count; each++)
            values[each] = text(r);
    }
    s->choice = made;
    if (!r->bad
        && (!between(s->continues, 0, made[s->branch].count) || made[s->formulation].count > FORMULATIONS))
        spoil(r, "its choices contradict each other");
}

static void switches(Reader *r)
{
    Scene *s = r->scene;
    Switch *made = enough(r, (size_t)s->switches, 20) ? room(r, (size_t)s->switches + 1, sizeof *made) : NULL;
    for (int k = 0; k < s->switches && !r->bad; k++) {
        made[k].holds = integer(r) != 0;
        made[k].value = integer(r);
        made[k].start = integer(r) != 0;
        made[k].count = integer(r);
        if (!between(made[k].value, -1, s->held) || !between(made[k].count, 0, s->l + 1))
            spoil(r, "switch %d has %d rows", k, made[k].count);
        made[k].rows = places(r, r->bad ? 0 : made[k].count, 0, s->l, "a row of a switch");
    }
    s->switched = made;
}

static void frictions(Reader *r)
{
    Scene *s = r->scene;
    Friction *made = enough(r, (size_t)s->frictions, 16) ? room(r, (size_t)s->frictions + 1, sizeof *made) : NULL;
    for (int k = 0; k < s->frictions && !r->bad; k++) {
        made[k].row = integer(r);
        made[k].value = integer(r);
        made[k].slip = integer(r);
        made[k].shared = integer(r) != 0;
        if (!between(made[k].row, 0, s->l) || !between(made[k].value, 0, s->held) || !between(made[k].slip, 0, s->held))
            spoil(r, "friction %d belongs to no constraint", k);
    }
    s->friction = made;
}

static void names(Reader *r)
{
    Scene *s = r->scene;
    const int there = enough(r, 8 * (size_t)s->n + 12 * (size_t)s->l, 1);
    Coordinate *coordinates = there ? room(r, (size_t)s->n, sizeof *coordinates) : NULL;
    Row *rows = there ? room(r, (size_t)s->l + 1, sizeof *rows) : NULL;
    const double *sizes;
    size_t count = 0;
    for (int k = 0; k < s->n && !r->bad; k++) {
        coordinates[k].name = text(r);
        coordinates[k].unit = text(r);
    }
    for (int k = 0; k < s->l && !r->bad; k++) {
        rows[k].name = text(r);
        rows[k].direction = text(r);
        rows[k].unit = text(r);
    }
    sizes = reals(r, &count);
    if (count != (size_t)s->l)
        spoil(r, "%zu rows have a size, not %d", count, s->l);
    for (int k = 0; k < s->l && !r->bad; k++) {
        rows[k].size = sizes[k];
        if (!(sizes[k] >= 0.0 && isfinite(sizes[k])))
            spoil(r, "the size of row %d is %g", k, sizes[k]);
    }
    s->coordinates = coordinates;
    s->timed = !r->bad && s->n > 0 && !strcmp(coordinates[s->n - 1].unit, "s");
    s->rows = rows;
}

/* Inputs that move something, where time is a coordinate. */
static void followed(Reader *r)
{
    Scene *s = r->scene;
    Followed *made;
    s->followed_count = s->timed ? integer(r) : 0;
    if (r->bad || s->followed_count < 0 || s->followed_count > s->inputs
        || s->held < s->counted + s->timed * (1 + s->followed_count * POLYNOMIAL)) {
        spoil(r, "%d inputs move something", s->followed_count);
        s->followed_count = 0;
        return;
    }
    made = room(r, (size_t)s->followed_count + 1, sizeof *made);
    for (int k = 0; k < s->followed_count && !r->bad; k++) {
        made[k].input = integer(r);
        made[k].derivatives = integer(r);
        made[k].order = integer(r);
        made[k].jump = real(r);
        if (!r->bad && (!between(made[k].derivatives, 0, 3) || !between(made[k].order, 0, 3) || !(made[k].jump > 0.0)
                || !between(made[k].input, 0, s->inputs - made[k].derivatives)))
            spoil(r, "input %d moves something by its derivative %d", made[k].input, made[k].derivatives);
    }
    s->followed = made;
}

/* The interface Jacobian, with which a file ends that has one: of each entry the variable, the output and the input. */
static void jacobian(Reader *r)
{
    Scene *s = r->scene;
    const int first = variable_count(s), count = integer(r);
    Variable *variables;
    Jacobian_entry *made;
    int *directions;
    if (!between(count, 1, 1 << 22) || !enough(r, (size_t)count, 48)) {
        spoil(r, "its interface Jacobian has %d entries", count);
        return;
    }
    variables = room(r, (size_t)(first + count), sizeof *variables);
    made = room(r, (size_t)count, sizeof *made);
    directions = room(r, (size_t)s->inputs + 1, sizeof *directions); /* of each input, from 1 on */
    if (r->bad)
        return;
    memcpy(variables, s->variables, (size_t)first * sizeof *variables);
    for (int k = 0; k < count; k++) {
        variable(r, OUTPUT, first + k, variables + first + k);
        made[k].output = integer(r);
        made[k].input = integer(r);
        if (r->bad || variables[first + k].type != REAL || !between(made[k].output, 0, s->readings)
            || !between(made[k].input, 0, s->inputs)) {
            spoil(r, "entry %d of its interface Jacobian is of no output or input", k);
            return;
        }
        if (!directions[made[k].input])
            directions[made[k].input] = ++s->directions;
        made[k].direction = directions[made[k].input] - 1;
    }
    s->variables = variables;
    s->jacobian = made;
    s->entries = count;
}

/* Every entry of a matrix, as a result of a function. */
static void dense(Reader *r, Pattern *made)
{
    const int rows = made->rows, columns = made->columns;
    int *offsets, *indices;
    if ((int64_t)rows * columns > MOST_NUMBERS / MOST_ARGUMENTS)
        spoil(r, "a matrix of %d by %d is dense", rows, columns);
    made->entries = r->bad ? 0 : rows * columns;
    made->offsets = offsets = room(r, (size_t)columns + 1, sizeof *offsets);
    made->indices = indices = room(r, (size_t)made->entries + 1, sizeof *indices);
    for (int c = 0; c <= columns && !r->bad; c++)
        offsets[c] = c * rows;
    for (int k = 0; k < made->entries && !r->bad; k++)
        indices[k] = k % rows;
}

static void pattern(Reader *r, Pattern *made, int rows, int columns)
{
    const int sparse = integer(r);
    made->rows = rows;
    made->columns = columns;
    if (!sparse) {
        dense(r, made);
        return;
    }
    made->offsets = places(r, columns + 1, 0, INT32_MAX, "the beginning of a column");
    if (r->bad)
        return;
    for (int c = 0; c < columns; c++)
        if (made->offsets[c] > made->offsets[c + 1] || made->offsets[0] != 0)
            spoil(r, "the columns of a matrix overlap");
    made->entries = made->offsets[columns];
    made->indices = places(r, made->entries, 0, rows, "a row of a matrix");
}

/* Places of nonzeros as a graph: which nodes meet in which edges. */
typedef struct {
    const Pattern *pattern;
    int shift; /* of its rows */
} Part;

/* Lists, for each node, its edges, or the other way round. */
typedef struct {
    int *offsets, *ends;
} Lists;

static Lists lists(Reader *r, int count, int by_rows, const Part *parts, int part_count)
{
    Lists made;
    size_t entries = 0;
    for (int k = 0; k < part_count; k++)
        entries += (size_t)parts[k].pattern->entries;
    made.offsets = room(r, (size_t)count + 2, sizeof *made.offsets);
    made.ends = room(r, entries + 1, sizeof *made.ends);
    if (r->bad)
        return made;
    /* Counted, then summed, then filled: the offsets stand one further on meanwhile. */
    for (int pass = 0; pass < 2; pass++) {
        for (int k = 0; k < part_count; k++) {
            const Pattern *p = parts[k].pattern;
            for (int c = 0; c < p->columns; c++)
                for (int e = p->offsets[c]; e < p->offsets[c + 1]; e++) {
                    const int row = p->indices[e] + parts[k].shift, from = by_rows ? row : c;
                    if (!pass)
                        made.offsets[from + 2]++;
                    else
                        made.ends[made.offsets[from + 1]++] = by_rows ? c : row;
                }
        }
        for (int k = 0; !pass && k < count; k++)
            made.offsets[k + 2] += made.offsets[k + 1];
    }
    return made;
}

/* Nodes in the order in which they are reached from the first of `order`, those with few neighbours first; `degree` is
   below zero where a node has been reached. Returns how many there are. */
static int reached(const Lists *edges, const Lists *nodes, int *order, int *degree, char *passed)
{
    int count = 1;
    degree[order[0]] = -1 - degree[order[0]];
    for (int at = 0; at < count; at++) {
        const int node = order[at], begin = count;
        for (int k = edges->offsets[node]; k < edges->offsets[node + 1]; k++) {
            const int edge = edges->ends[k];
            if (passed[edge])
                continue;
            passed[edge] = 1;
            for (int e = nodes->offsets[edge]; e < nodes->offsets[edge + 1]; e++) {
                const int other = nodes->ends[e];
                int place = count;
                if (degree[other] < 0)
                    continue;
                degree[other] = -1 - degree[other];
                for (; place > begin && degree[order[place - 1]] < degree[other]; place--)
                    order[place] = order[place - 1];
                order[place] = other;
                count++;
            }
        }
    }
    return count;
}

/* An envelope for what nodes that meet in an edge have in common: the order of Cuthill and McKee (1969), reversed. */
static void envelope(Reader *r, Envelope *made, int count, int edge_count, int by_rows, const Part *parts, int part_count)
{
    const Lists edges = lists(r, count, by_rows, parts, part_count);
    const Lists nodes = lists(r, edge_count, !by_rows, parts, part_count);
    int *order = room(r, (size_t)count + 1, sizeof *order), *degree = room(r, (size_t)count + 1, sizeof *degree);
    int *place = room(r, (size_t)count + 1, sizeof *place), *first = room(r, (size_t)count + 1, sizeof *first);
    ptrdiff_t *start = room(r, (size_t)count + 1, sizeof *start), entries = 0;
    char *passed = room(r, (size_t)edge_count + 1, 1);
    int found = 0;
    if (r->bad)
        return;
    for (int k = 0; k < count; k++)
        for (int e = edges.offsets[k]; e < edges.offsets[k + 1]; e++) {
            const int edge = edges.ends[e];
            degree[k] += nodes.offsets[edge + 1] - nodes.offsets[edge] - 1;
        }
    for (int k = 0; k < count; k++) {
        int reach;
        if (degree[k] < 0)
            continue;
        /* From the node that is farthest from any. */
        order[found] = k;
        reach = reached(&edges, &nodes, order + found, degree, passed);
        for (int at = found; at < found + reach; at++) {
            degree[order[at]] = -1 - degree[order[at]];
            for (int e = edges.offsets[order[at]]; e < edges.offsets[order[at] + 1]; e++)
                passed[edges.ends[e]] = 0;
        }
        order[found] = order[found + reach - 1];
        found += reached(&edges, &nodes, order + found, degree, passed);
    }
    for (int k = 0; k < count; k++)
        place[order[k]] = first[count - 1 - k] = count - 1 - k;
    for (int edge = 0; edge < edge_count; edge++) {
        int least = count;
        for (int pass = 0; pass < 2; pass++)
            for (int e = nodes.offsets[edge]; e < nodes.offsets[edge + 1]; e++) {
                int *row = pass ? first + place[nodes.ends[e]] : &least;
                const int other = pass ? least : place[nodes.ends[e]];
                *row = other < *row ? other : *row;
            }
    }
    for (int k = 0; k < count; k++) {
        start[k] = entries - first[k];
        entries += k + 1 - first[k];
    }
    if (entries > MOST_NUMBERS)
        spoil(r, "the matrices of its start have %lld numbers", (long long)entries);
    *made = (Envelope){count, place, first, start, (size_t)entries};
}

/* Functions -------------------------------------------------------------------------------------------------------- */

/* Whether runs keep within their list and use what is there before them; `values` counts what they give. `next` reads
   the word at a place. */
typedef struct {
    const Function *f;
    size_t at;
    int64_t known; /* places before what comes next */
    Reader *reader;
} Checked;

static int64_t word(const Checked *c, size_t at)
{
    return c->f->narrow ? (int64_t)c->f->narrow[at] : (int64_t)c->f->wide[at];
}

static int operands_of(int64_t kind)
{
    static const unsigned char counts[] = {OPERAND_COUNTS};
    return counts[kind];
}

/* Whether an operation of `count` passes uses what is known before it; `more` are values that each pass adds. */
static int within_passes(int64_t first, int64_t step, int64_t known, int64_t passes, int64_t more)
{
    const int64_t last = first + (passes - 1) * step;
    /* Between them both sides change evenly, so that the ends tell. */
    return first >= 0 && last >= 0 && first < known && last < known + (passes - 1) * more;
}

/* The operands of an operation in passes, from where the check is. */
static void checked_passes(Checked *c, int64_t kind, int64_t known, int64_t passes, int64_t more)
{
    for (int k = 0; k < operands_of(kind); k++, c->at += 2)
        if (!within_passes(word(c, c->at), word(c, c->at + 1), known, passes, more))
            spoil(c->reader, "a loop uses what is not known yet");
}

/* One pass of a loop, of which there are `passes`, up to `end`. */
static void checked_body(Checked *c, size_t end, int64_t passes, int64_t values)
{
    int64_t made = 0;
    while (end - c->at >= 2 && !c->reader->bad) {
        const int64_t kind = word(c, c->at);
        int64_t count = word(c, c->at + 1);
        c->at += 2;
        if (kind < 0 || kind >= KIND_COUNT) {
            spoil(c->reader, "there is no operation %d in a loop", (int)kind);
            return;
        }
        if (count < 0 || (uint64_t)count > (end - c->at) / (2 * (unsigned)operands_of(kind))) {
            spoil(c->reader, "a loop of a function is damaged");
            return;
        }
        for (; count > 0; count--, made += VALUES_OF(kind))
            checked_passes(c, kind, c->known + made, passes, values);
    }
    if (c->at != end || made != values)
        spoil(c->reader, "a loop of a function is damaged");
}

/* What stands in wide functions alone; 0 where it is none of it. */
static int checked_loop(Checked *c, int64_t kind, int64_t count)
{
    const size_t left = c->f->words - c->at;
    if (!c->f->wide || (kind != LOOP_KIND && kind != EACH_KIND && kind != GATHER_KIND))
        return 0;
    if (count < 1 || left < 2) {
        spoil(c->reader, "a loop of a function is damaged");
    } else if (kind == GATHER_KIND) {
        if ((uint64_t)count > left) {
            spoil(c->reader, "a function is damaged");
            return 1;
        }
        for (int64_t k = 0; k < count; k++, c->at++)
            if (word(c, c->at) < 0 || word(c, c->at) >= c->known)
                spoil(c->reader, "a function copies what is not known yet");
        c->known += count;
    } else if (kind == EACH_KIND) {
        const int64_t each = word(c, c->at);
        if (each < 0 || each >= KIND_COUNT || left - 1 < 2 * (size_t)operands_of(each)) {
            spoil(c->reader, "a loop of a function is damaged");
            return 1;
        }
        c->at++;
        checked_passes(c, each, c->known, count, 0);
        c->known += count * VALUES_OF(each);
    } else {
        const int64_t values = word(c, c->at), body = word(c, c->at + 1);
        if (values < 1 || values > MOST_NUMBERS / count || body < 0 || (uint64_t)body > left - 2) {
            spoil(c->reader, "a loop of a function is damaged");
            return 1;
        }
        c->at += 2;
        checked_body(c, c->at + (size_t)body, count, values);
        c->known += count * values;
    }
    if (c->known > MOST_NUMBERS)
        spoil(c->reader, "a function is too long");
    return 1;
}

static void checked_function(Reader *r, Function *f)
{
    Checked c = {f, 0, r->scene->constant_count, r};
    for (int k = 0; k < f->inputs; k++)
        c.known += f->lengths[k];
    while (c.at < f->words && !r->bad) {
        int64_t operation, count;
        int operands;
        if (f->words - c.at < 2) {
            spoil(r, "a function is damaged");
            return;
        }
        operation = word(&c, c.at);
        count = word(&c, c.at + 1);
        c.at += 2;
        if (checked_loop(&c, operation, count))
            continue;
        if (operation < 0 || operation >= KIND_COUNT) {
            spoil(r, "there is no operation %d", (int)operation);
            return;
        }
        operands = operands_of(operation);
        if (count < 0 || (uint64_t)count > (f->words - c.at) / (unsigned)operands) {
            spoil(r, "a function is damaged");
            return;
        }
        for (; count > 0; count--, c.known += VALUES_OF(operation))
            for (int k = 0; k < operands; k++, c.at++)
                if (word(&c, c.at) < 0 || word(&c, c.at) >= c.known)
                    spoil(r, "an operation uses what is not known yet");
    }
    for (size_t k = 0; k < (size_t)f->results && !r->bad; k++)
        if (word(&c, f->words + k) < 0 || word(&c, f->words + k) >= c.known)
            spoil(r, "a function gives what it does not know");
    if (c.known > MOST_NUMBERS) {
        spoil(r, "a function is too long");
        return;
    }
    f->registers = (int)c.known;
    if (f->registers > r->scene->registers)
        r->scene->registers = f->registers;
}

/* Places from differences to those before, `step` words from each other; from `first` on they count back from `end`. */
static void sum_up(const uint16_t *differences, size_t count, uint32_t first, uint32_t end, uint16_t *places, size_t step)
{
    uint16_t sum = 0;
    for (size_t k = 0; k < count; k++) {
        sum = (uint16_t)(sum + differences[k]);
        places[k * step] = (uint16_t)(sum < first ? sum : sum + end);
    }
}

/* Words and results of a function whose places have 16 bits. In the file there are the kinds of its runs and how many
   operations each has, then the operands, then the results; of a run all first operands come before the second ones. */
static void narrow_function(Reader *r, Function *f, int64_t first)
{
    size_t heads = 0, left = 0, results = 0, words = 0, k = 0;
    const uint16_t *head = narrow_integers(r, &heads), *operand = narrow_integers(r, &left);
    const uint16_t *result = narrow_integers(r, &results);
    uint16_t *made = r->bad ? NULL : room(r, heads + left + results + 1, sizeof *made);
    uint32_t end = (uint32_t)first;
    if (!made)
        return;
    for (; k + 1 < heads; k += 2) {
        const unsigned kind = head[k], count = head[k + 1];
        const unsigned each = kind < KIND_COUNT ? (unsigned)operands_of(kind) : 0;
        if (!each || count > left / each)
            break;
        made[words++] = (uint16_t)kind;
        made[words++] = (uint16_t)count;
        end += count * VALUES_OF(kind);
        for (unsigned j = 0; j < each; j++, operand += count)
            sum_up(operand, count, (uint32_t)first, end, made + words + j, each);
        words += count * each;
        left -= count * each;
    }
    if (left || k < heads) {
        spoil(r, "a function is damaged");
        return;
    }
    sum_up(result, results, (uint32_t)first, end, made + words, 1);
    f->narrow = made;
    f->words = words;
    f->results = (int)results;
}

static void function(Reader *r, Function *f)
{
    size_t inputs = 0, outputs = 0;
    const int32_t *in = integers(r, -1, &inputs), *out = integers(r, -1, &outputs);
    const int wide = integer(r);
    int32_t *lengths;
    int64_t all = 0, known = r->scene->constant_count;
    if (inputs + outputs > MOST_ARGUMENTS)
        spoil(r, "a function has %zu arguments and results", inputs + outputs);
    if (r->bad || !(lengths = room(r, inputs + outputs + 1, sizeof *lengths)))
        return;
    memcpy(lengths, in, inputs * sizeof *in);
    memcpy(lengths + inputs, out, outputs * sizeof *out);
    for (size_t k = 0; k < inputs + outputs; k++) {
        if (lengths[k] < 0 || lengths[k] > MOST_NUMBERS / MOST_ARGUMENTS)
            spoil(r, "an argument of a function has %d numbers", (int)lengths[k]);
        *(k < inputs ? &known : &all) += lengths[k];
    }
    if ((r->results += all) > MOST_RESULTS)
        spoil(r, "its functions give too many numbers");
    f->inputs = (int)inputs;
    f->outputs = (int)outputs;
    f->lengths = lengths;
    /* Words and results stand behind each other. */
    if (wide) {
        size_t words = 0, rows = 0;
        int64_t spare = 2 * all; /* entries that are said twice at most */
        const int32_t *first = integers(r, -1, &words), *then = integers(r, -1, &rows);
        int32_t *both = r->bad ? NULL : room(r, words + (size_t)all + 1, sizeof *both);
        if (!both)
            return;
        memcpy(both, first, words * sizeof *both);
        for (int64_t k = 0; k < all; k++)
            both[words + (size_t)k] = -1;
        /* How many, the first entry and the step to the next, the place of the first and the step. */
        for (const int32_t *row = then; row + 5 <= then + rows; row += 5) {
            const int64_t count = row[0], last = row[1] + (count - 1) * row[2];
            if (count < 1 || (spare -= count) < 0 || row[1] < 0 || row[1] >= all || last < 0 || last >= all) {
                spoil(r, "the results of a function are damaged");
                return;
            }
            for (int64_t each = 0; each < count; each++)
                both[words + (size_t)(row[1] + each * row[2])] = (int32_t)(row[3] + each * row[4]);
        }
        f->wide = both;
        f->words = words;
        f->results = (int)all;
    } else {
        narrow_function(r, f, known);
    }
    if (!r->bad && f->results != all)
        spoil(r, "a function gives %d numbers in place of %d", f->results, (int)all);
    checked_function(r, f);
}

/* Whether a function that the runtime calls takes and gives what it hands over. */
static void shaped(Reader *r, const char *name, int which, int needed, int inputs, int outputs, ...)
{
    const Scene *s = r->scene;
    const Function *f;
    va_list lengths;
    if (r->bad)
        return;
    if (which < 0 || which >= s->function_count) {
        if (which != -1 || needed)
            spoil(r, "there is no function %s", name);
        return;
    }
    f = s->functions + which;
    if (f->inputs != inputs || f->outputs != outputs) {
        spoil(r, "the function %s has %d arguments and %d results", name, f->inputs, f->outputs);
        return;
    }
    va_start(lengths, outputs);
    for (int k = 0; k < inputs + outputs; k++) {
        const int wanted = va_arg(lengths, int);
        if (f->lengths[k] != wanted)
            spoil(r, "the function %s has %d numbers where %d are wanted", name, f->lengths[k], wanted);
    }
    va_end(lengths);
}

static void functions(Reader *r)
{
    Scene *s = r->scene;
    const int n = s->n, l = s->l, P = s->own + s->held, K = settings_length(s), ties = s->ties;
    Function *made;
    size_t count;
    s->constants = reals(r, &count);
    s->constant_count = (int)count;
    s->registers = s->constant_count;
    count = length(r);
    made = enough(r, count, 20) ? room(r, count + 1, sizeof *made) : NULL;
    for (size_t k = 0; k < count && !r->bad; k++)
        function(r, made + k);
    s->functions = made;
    s->function_count = (int)count;
    shaped(r, "dynamics", s->dynamics, 1, 5, 4, n, n, driven_by(s), P, 1, s->mass.entries, s->constraint.entries, n, l);
    shaped(r, "constraints", s->constraints, 1, 3, 4, n, n, P, s->mass.entries, s->constraint.entries, l, l);
    shaped(r, "energy", s->energy, 1, 3, 2, n, n, P, 1, 1);
    shaped(r, "closure", s->closure, 1, 3, 4, n, P, s->starts, s->gaps.entries, s->tie_rows.entries, l, ties);
    shaped(r, "guesses", s->guesses, 1, 3, 2, P, s->starts, s->starts, n, n);
    shaped(r, "displacements", s->displacements, s->held > 0, 2, 1, n, P, s->held);
    shaped(r, "sliding", s->sliding, s->frictions > 0, 3, 1, n, n, P, s->frictions);
    shaped(r, "breaks", s->breaks, s->break_count > 0, 4, 1, 1, s->inputs, s->inputs, P, 2 * s->break_count);
    shaped(r, "pivots", s->pivots, l > 0, 3, 4, n, P, K, n, n, n, 1);
    shaped(r, "place", s->place, l > 0, 3, 1, n, P, K, n);
    shaped(r, "bring", s->bring, l > 0, 5, 2, n, n, n, P, K, n, n);
    shaped(r, "settle", s->settle, l > 0, 4, 3, n, n, P, K, n, 1, 2);
}

/* Laws of time that may jump, or not be finite. */
static void leaps(Reader *r)
{
    Scene *s = r->scene;
    Leap *made;
    const size_t count = s->timed ? length(r) : 0;
    made = enough(r, count, 16) ? room(r, count + 1, sizeof *made) : NULL;
    for (size_t k = 0; k < count && !r->bad; k++) {
        made[k].what = text(r);
        made[k].unit = text(r);
        made[k].rate_unit = text(r);
        made[k].row = integer(r);
        if (!r->bad && !between(made[k].row, -1, s->l))
            spoil(r, "a law counts with constraint %d", made[k].row);
    }
    s->leaps = made;
    s->leap_count = (int)count;
    shaped(r, "laws", s->laws, count > 0, 3, 1, s->n, s->n, s->own + s->held, 3 * (int)count);
}

/* Limits of stops, and what they are of. */
static void limits(Reader *r)
{
    Scene *s = r->scene;
    const Function *f = between(s->stops, 0, s->function_count) ? s->functions + s->stops : NULL;
    const int count = f && f->inputs == 2 && f->outputs == 2 ? f->lengths[2] : 0;
    Limit *made = enough(r, (size_t)count, 8) ? room(r, (size_t)count + 1, sizeof *made) : NULL;
    for (int k = 0; k < count && !r->bad; k++) {
        made[k].name = text(r);
        made[k].unit = text(r);
    }
    s->limited = made;
    s->limit_count = count;
    shaped(r, "stops", s->stops, 0, 2, 2, s->n, s->own + s->held, count, (int64_t)count * s->n < INT32_MAX ? count * s->n : 0);
}

/* Programs --------------------------------------------------------------------------------------------------------- */

static int within(const Reader *r, int64_t place, int64_t length)
{
    return place >= 0 && length >= 0 && place + length <= (int64_t)r->scene->size + r->scene->workspace;
}

static void checked_program(Reader *r, const int32_t *code, size_t words, int depth)
{
    const Scene *s = r->scene;
    size_t at = 0;
    if (depth > DEEPEST)
        spoil(r, "its choices and loops are too deep");
    while (at < words && !r->bad) {
        const int32_t *c = code + at + 1;
        const size_t left = words - at - 1;
        switch (code[at]) {
        case CALL_CODE: {
            const Function *f = left ? s->functions + c[0] : NULL;
            if (!left || !between(c[0], 0, s->function_count) || left - 1 < (size_t)(f->inputs + f->outputs)) {
                spoil(r, "a program calls what is not there");
                return;
            }
            for (int k = 0; k < f->inputs + f->outputs; k++)
                if (!within(r, c[1 + k], f->lengths[k]))
                    spoil(r, "a program leaves the memory");
            at += 2 + (size_t)(f->inputs + f->outputs);
            break;
        }
        case CHOICE_CODE:
            if (left < 3 || !within(r, c[0], 1) || c[1] < 0 || c[2] < 0 || (size_t)c[1] > left - 3
                || (size_t)c[2] > left - 3 - (size_t)c[1]) {
                spoil(r, "a choice of a program is damaged");
                return;
            }
            checked_program(r, c + 3, (size_t)c[1], depth + 1);
            checked_program(r, c + 3 + c[1], (size_t)c[2], depth + 1);
            at += 4 + (size_t)c[1] + (size_t)c[2];
            break;
        case LOOP_CODE:
            if (left < 3 || !within(r, c[0], 1) || (c[1] < 0 && !within(r, -1 - (int64_t)c[1], 1)) || c[2] < 0
                || (size_t)c[2] > left - 3) {
                spoil(r, "a loop of a program is damaged");
                return;
            }
            checked_program(r, c + 3, (size_t)c[2], depth + 1);
            at += 4 + (size_t)c[2];
            break;
        case FACTOR_CODE: {
            int64_t side, parts;
            if (left < 6 || !between(c[0], 1, 10000) || !between(c[1], 1, 100) || !between(c[2], 1, 100)) {
                spoil(r, "a factorisation of a program is damaged");
                return;
            }
            side = (int64_t)c[0] * c[1];
            parts = (int64_t)c[1] * c[2];
            if (parts > MOST_ARGUMENTS || left < 6 + (size_t)parts || !within(r, c[3], c[1] * parts)
                || !within(r, c[4 + parts], side * side) || !within(r, c[5 + parts], side)) {
                spoil(r, "a factorisation of a program is damaged");
                return;
            }
            for (int64_t k = 0; k < parts; k++)
                if (!within(r, c[4 + k], (int64_t)c[0] * c[0]))
                    spoil(r, "a program leaves the memory");
            at += 7 + (size_t)parts;
            break;
        }
        case SOLVE_CODE: {
            int64_t side;
            if (left < 5 || !between(c[0], 1, 10000) || !between(c[1], 1, MOST_ARGUMENTS) || left < 5 + (size_t)c[1]) {
                spoil(r, "a solution of a program is damaged");
                return;
            }
            side = (int64_t)c[0] * c[1];
            if (!within(r, c[2], side * side) || !within(r, c[3], side) || !within(r, c[4 + c[1]], side))
                spoil(r, "a program leaves the memory");
            for (int k = 0; k < c[1]; k++)
                if (!within(r, c[4 + k], c[0]))
                    spoil(r, "a program leaves the memory");
            at += 6 + (size_t)c[1];
            break;
        }
        case LEAST_NORM_CODE:
            if (left < 4 || !between(c[0], 1, MOST_UNKNOWNS)) {
                spoil(r, "a dense system of a program is damaged");
                return;
            }
            if (!within(r, c[1], (int64_t)c[0] * c[0]) || !within(r, c[2], c[0]) || !within(r, c[3], c[0]))
                spoil(r, "a program leaves the memory");
            else if (c[0] > r->scene->dense)
                r->scene->dense = c[0];
            at += 5;
            break;
        case LANES_CODE: {
            const Function *f = left > 1 ? s->functions + c[1] : NULL;
            if (left < 2 || c[0] < 1 || !between(c[1], 0, s->function_count)
                || (left - 2) / (unsigned)c[0] < (size_t)(f->inputs + f->outputs)) {
                spoil(r, "a program calls what is not there");
                return;
            }
            c += 2;
            for (int32_t lane = 0; lane < code[at + 1]; lane++)
                for (int k = 0; k < f->inputs + f->outputs; k++)
                    if (!within(r, *c++, f->lengths[k]))
                        spoil(r, "a program leaves the memory");
            at = (size_t)(c - code);
            if (f->narrow && f->registers > s->lane_registers)
                r->scene->lane_registers = f->registers;
            break;
        }
        default:
            spoil(r, "a program has no step %d", (int)code[at]);
        }
    }
}

int move_by(const Scene *s, int formulation)
{
#define OF(name) , s->move_##name
    const int programs[] = {s->move SCENE_OTHERS(OF)};
#undef OF
    return programs[formulation];
}

static void programs(Reader *r)
{
    Scene *s = r->scene;
    const size_t count = length(r);
    Program *made = enough(r, count, 4) ? room(r, count + 1, sizeof *made) : NULL;
    for (size_t k = 0; k < count && !r->bad; k++) {
        made[k].code = integers(r, -1, &made[k].words);
        if (!r->bad)
            checked_program(r, made[k].code, made[k].words, 0);
    }
    s->programs = made;
    s->program_count = (int)count;
#define KNOWN(name) \
    if (!between(s->name, -1, s->program_count)) \
        spoil(r, "there is no program " #name);
    SCENE_PROGRAMS(KNOWN)
#undef KNOWN
    if (s->quick < 0 || s->careful < 0 || s->instant < 0 || (s->method && s->method_step < 0)
        || (s->stiff_step >= 0 && s->method != 1)
        || (s->short_step >= 0 && (s->method != 1 || s->short_cost < 1 || s->method_cost < 1))
        || (s->l && (s->move < 0 || s->close < 0 || s->keep < 0 || s->impact < 0)))
        spoil(r, "a program is missing");
    for (int k = 0; !r->bad && s->l && k < s->choice[s->formulation].count; k++)
        if (move_by(s, k) < 0)
            spoil(r, "the program of a formulation is missing");
}

/* Memory ----------------------------------------------------------------------------------------------------------- */

int variable_count(const Scene *s)
{
    return outputs_from(s) + s->outputs + s->entries;
}

/* Reference of the first output. */
int outputs_from(const Scene *s)
{
    return s->parameters + s->choices + s->inputs + s->switches;
}

int settings_length(const Scene *s)
{
    return SETTINGS + 2 * s->l + s->n + s->compliances + (s->brakes ? s->l * s->l : 0);
}

size_t state_length(const Scene *s)
{
    return (size_t)s->near + 1;
}

/* They stand between the work and the time. */
int states_of(const Scene *s)
{
    return s->time - s->work - 1;
}

int driven_by(const Scene *s)
{
    return s->inputs + states_of(s);
}

/* Whether what the runtime itself reads and writes is within the memory. */
static void memory(Reader *r)
{
    const Scene *s = r->scene;
    const int states = states_of(s), state = 2 * s->n + s->angles + states + 6;
    const struct {
        int place, length;
    } fields[] = {{s->z, state}, {s->after, state}, {s->begin, state}, {s->u, s->inputs}, {s->p, s->own + s->held},
        {s->k, settings_length(s)}, {s->dt, 1}, {s->control, CONTROL}, {s->tally, TALLY}, {s->pace, PACE},
        {s->past, s->past_size}, {s->seen, s->seen_size}},
      handed[] = {{s->most, 1}, {s->patient, 1}, {s->du, s->inputs}, {s->slopes, s->inputs + 1}, {s->within, 1},
          {s->q, s->n}, {s->v, s->n}, {s->watch0, WATCH}, {s->watch1, WATCH}, {s->watch2, WATCH}, {s->watch3, WATCH},
          {s->watch4, WATCH}, {s->q1, s->n}, {s->q2, s->n}, {s->q3, s->n}, {s->q4, s->n}, {s->v1, s->n}, {s->v2, s->n},
          {s->v3, s->n}, {s->v4, s->n}, {s->again, 1}, {s->stabilisation, 2}, {s->projects, 1}, {s->dy, s->readings},
          {s->struck, s->n}, {s->impulse, s->l}, {s->lost, 1}, {s->read_watch, WATCH}, {s->grip, 3 * s->frictions + 2}};
    if (!between(s->size, 1, MOST_NUMBERS) || !between(s->workspace, 0, MOST_NUMBERS))
        spoil(r, "its memory has %d numbers", s->size);
    if (s->counted > s->angles || s->counted > s->held)
        spoil(r, "its angles contradict each other");
    if (s->work != 2 * s->n + s->angles || s->trouble != s->time + 1 || s->change != s->time + 2 || s->near != s->time + 4)
        spoil(r, "its state contradicts itself");
    if (!between(s->monitor_position, -1, s->outputs - s->event_count)
        || !between(s->monitor_velocity, -1, s->outputs - s->event_count)
        || !between(s->monitor_energy, -1, s->outputs - s->event_count)
        || !between(s->monitor_iterations, -1, s->outputs - s->event_count)
        || !between(s->monitor_step_error, -1, s->outputs - s->event_count))
        spoil(r, "its monitors contradict each other");
    if (s->seen_size < SEEN + s->outputs - s->event_count || s->readings > s->outputs - s->event_count)
        spoil(r, "its outputs contradict each other");
    if (s->pace > s->past || (int64_t)s->tally + TALLY > s->pace || s->dt > s->tally)
        spoil(r, "its fields are not in order");
    for (size_t k = 0; k < sizeof fields / sizeof *fields; k++)
        if (fields[k].place < 0 || fields[k].place + (int64_t)fields[k].length > s->size)
            spoil(r, "a field is outside its memory");
    for (size_t k = 0; k < sizeof handed / sizeof *handed; k++)
        if (handed[k].place < 0 || handed[k].place + (int64_t)handed[k].length > s->workspace)
            spoil(r, "a value is outside its workspace");
}

/* A check sum goes on: CRC-32 as in zip archives, four bytes at a time. */
uint32_t check_sum_from(uint32_t sum, const unsigned char *at, size_t count)
{
    uint32_t table[4][256];
    for (uint32_t k = 0; k < 256; k++) {
        table[0][k] = k;
        for (int bit = 0; bit < 8; bit++)
            table[0][k] = table[0][k] >> 1 ^ (table[0][k] & 1 ? 0xedb88320u : 0);
    }
    for (int j = 1; j < 4; j++)
        for (int k = 0; k < 256; k++)
            table[j][k] = table[j - 1][k] >> 8 ^ table[0][table[j - 1][k] & 255];
    for (; count >= 4; count -= 4, at += 4) {
        sum ^= (uint32_t)little(at, 4);
        sum = table[3][sum & 255] ^ table[2][sum >> 8 & 255] ^ table[1][sum >> 16 & 255] ^ table[0][sum >> 24];
    }
    for (; count; count--, at++)
        sum = table[0][(sum ^ *at) & 255] ^ sum >> 8;
    return sum;
}

static void body(Reader *r)
{
    Scene *s = r->scene;
    size_t count = 0;
    s->name = text(r);
    numbers(r);
    if (r->bad)
        return;
    memory(r);
    variables(r);
    choices(r);
    switches(r);
    frictions(r);
    s->impulse_rows = places(r, s->impulses, 0, s->l, "a row of an impulse");
    s->event_places = places(r, s->event_count, 0, s->impulses + 1 + s->peaks, "the place of an impulse");
    s->peak_parts = places(r, 3 * s->peaks, -1, s->readings, "a part of a peak");
    s->angle_starts = places(r, s->angles, -1, s->starts, "the start of an angle");
    s->tied = places(r, s->ties, 0, s->starts, "a start value");
    s->break_levels = places(r, s->break_count, 0, s->break_count, "a level");
    if (!r->bad)
        names(r);
    s->normal = reals(r, &count);
    if (count < (size_t)(TRIES > RANKED ? TRIES : RANKED) * (size_t)s->n)
        spoil(r, "it has %zu standard normal numbers", count);
    if (r->bad)
        return;
    pattern(r, &s->mass, s->n, s->n);
    pattern(r, &s->constraint, s->l, s->n);
    pattern(r, &s->gaps, s->l, s->n);
    pattern(r, &s->tie_rows, s->ties, s->n);
    if (!r->bad) {
        const Part rows[] = {{&s->constraint, 0}, {&s->gaps, 0}, {&s->tie_rows, s->l}};
        const Part masses[] = {{&s->constraint, 0}, {&s->mass, s->l}};
        envelope(r, &s->closing, s->l + s->ties, s->n, 1, rows, 3);
        envelope(r, &s->holding, s->n, s->l + s->n, 0, masses, 2);
    }
    functions(r);
    programs(r);
    if (!r->bad)
        followed(r);
    if (!r->bad)
        leaps(r);
    if (!r->bad)
        limits(r);
    if (!r->bad && r->at != r->end)
        jacobian(r);
    if (!r->bad && r->at != r->end)
        spoil(r, "%zu bytes follow it", (size_t)(r->end - r->at));
}

Scene *scene_load(const unsigned char *bytes, size_t size, char *why, size_t why_size)
{
    static const char magic[] = "ALFMU\r\n\x1a";
    Scene *s = calloc(1, sizeof *s);
    Reader r = {bytes, bytes + size, s, why, why_size, 0, 0};
    if (!s) {
        snprintf(why, why_size, "there is no memory for it");
        return NULL;
    }
    if (size < HEAD || memcmp(bytes, magic, sizeof magic - 1))
        spoil(&r, "it is not a scene file");
    else if (little(bytes + 8, 4) != SCENE_VERSION)
        spoil(&r, "its version is %u and this runtime reads %u; export it again", (unsigned)little(bytes + 8, 4),
            (unsigned)SCENE_VERSION);
    else if (little(bytes + 12, 4) != size)
        spoil(&r, "it has %zu bytes in place of %u", size, (unsigned)little(bytes + 12, 4));
    else if (little(bytes + 16, 8) != (uint32_t)~check_sum_from(CHECK_BEGIN, bytes + 24, size - 24))
        spoil(&r, "its check sum does not agree; it is damaged");
    else {
        memcpy(s->guid, bytes + 24, sizeof s->guid - 1);
        s->body = ~check_sum_from(CHECK_BEGIN, bytes + HEAD, size - HEAD);
        r.at = bytes + HEAD;
        body(&r);
    }
    if (r.bad) {
        scene_free(s);
        return NULL;
    }
    return s;
}

int scene_compiled(Scene *s, Compiled *const *functions, int count, int spare, const char *identity)
{
    Function *own = (Function *)s->functions; /* which the scene itself has made */
    char body[9];
    snprintf(body, sizeof body, "%08x", s->body);
    if (count != s->function_count || !between(spare, 0, MOST_NUMBERS) || strcmp(identity, body))
        return 0;
    for (int k = 0; k < count; k++)
        own[k].compiled = functions[k];
    s->spare = spare;
    return 1;
}

void scene_free(Scene *s)
{
    struct Block *block = s ? s->blocks : NULL;
    while (block) {
        struct Block *next = block->next;
        free(block);
        block = next;
    }
    free(s);
}
