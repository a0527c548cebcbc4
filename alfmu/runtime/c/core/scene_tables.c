#include "scene_tables.h"

#include "instance.h"
#include "layout.h"
#include "linear.h"
#include "scene.h"
#include "scene_functions.h"
#include "scene_reader.h"
#include "scene_sizes.h"

/* Read the numbers of the scene. Counts are checked here, so that their sums do not overflow. */
void tables_read_numbers(Reader *r)
{
    Scene *s = r->scene;
#define READ(name) s->name = reader_integer(r);
    SCENE_NUMBERS(READ)
#undef READ
#define READ(name) s->name = reader_real(r);
    SCENE_REALS(READ)
#undef READ
#define COUNTED(name) \
    if (!reader_check_between(s->name, 0, 1 << 22)) \
        reader_spoil(r, "the number of " #name " is %d", s->name);
    SCENE_COUNTS(COUNTED)
#undef COUNTED
    if (r->bad)
        return;
    if (!reader_check_between(s->work, 0, 1 << 25) || !reader_check_between(s->time, s->work + 1, s->work + (1 << 22)))
        reader_spoil(r, "its state contradicts itself");
    else if (s->own + 2 * s->starts + s->compliances + scene_states(s) + s->solver != s->parameters || s->n < 1
        || (s->compliances != 0 && s->compliances != s->l) || s->event_count > s->outputs)
        reader_spoil(r, "its counts contradict each other");
#define REFERENCE(name)                                                                                                \
    if (!r->bad                                                                                                        \
        && !reader_check_between(s->name, s->own + 2 * s->starts + s->compliances + scene_states(s), s->parameters))   \
        reader_spoil(r, #name " has the reference %d", s->name);
    SCENE_REFERENCES(REFERENCE)
#undef REFERENCE
    if (!reader_check_between(s->branch, 0, s->choices) || !reader_check_between(s->method_choice, 0, s->choices)
        || !reader_check_between(s->formulation, 0, s->choices) || s->choices != CHOICES)
        reader_spoil(r, "its choices contradict each other");
    if (s->brakes && s->l > 10000)
        reader_spoil(r, "it has %d constraints, some of them redundant; at most 10000 may be", s->l);
    if (!(s->farthest >= 0.0 && isfinite(s->farthest)))
        reader_spoil(r, "its farthest point is at %g m", s->farthest);
    if (!(s->fading >= 0.0 && isfinite(s->fading)))
        reader_spoil(r, "its rate of return to the constraints is %g 1/s", s->fading);
    if (!reader_check_between(s->method, 0, 3) || s->freedom > s->n)
        reader_spoil(r, "its method contradicts itself");
}

static void read_variable(Reader *r, int kind, int k, Variable *made)
{
    const int type = (made->name = reader_text(r), made->unit = reader_text(r), reader_integer(r));
    made->type = (Type)type;
    made->kind = (Kind)kind;
    made->instant = reader_integer(r) != 0;
    made->start = reader_real(r);
    made->minimum = reader_real(r);
    made->maximum = reader_real(r);
    if (!reader_check_between(type, REAL, STRING + 1) || (type == STRING) != (kind == CHOICE)
        || (type == BOOLEAN) != (kind == SWITCH))
        reader_spoil(r, "variable %d has the type %d", k, type);
}

void tables_read_variables(Reader *r)
{
    Scene *s = r->scene;
    const int kinds[] = {s->parameters, s->choices, s->inputs, s->switches, s->outputs},
              count = scene_variable_count(s);
    Variable *made = reader_has(r, (size_t)count, 40) ? reader_alloc(r, (size_t)count + 1, sizeof *made) : NULL;
    int k = 0;
    for (int kind = 0; kind < 5; kind++)
        for (int each = 0; each < kinds[kind] && !r->bad; each++, k++)
            read_variable(r, kind, k, made + k);
    s->variables = made;
}

void tables_read_choices(Reader *r)
{
    Scene *s = r->scene;
    Choice *made = reader_has(r, (size_t)s->choices, 8) ? reader_alloc(r, (size_t)s->choices + 1, sizeof *made) : NULL;
    for (int k = 0; k < s->choices && !r->bad; k++) {
        const char **values;
        made[k].start = reader_integer(r);
        made[k].count = (int)reader_length(r);
        if (!reader_check_between(made[k].count, 1, 1000) || !reader_check_between(made[k].start, 0, made[k].count))
            reader_spoil(r, "choice %d has %d values", k, made[k].count);
        made[k].values = values = reader_alloc(r, (size_t)made[k].count, sizeof *values);
        for (int each = 0; !r->bad && each < made[k].count; each++)
            values[each] = reader_text(r);
    }
    s->choice = made;
    if (!r->bad
        && (!reader_check_between(s->continues, 0, made[s->branch].count) || made[s->formulation].count > FORMULATIONS))
        reader_spoil(r, "its choices contradict each other");
}

void tables_read_switches(Reader *r)
{
    Scene *s = r->scene;
    Switch *made
        = reader_has(r, (size_t)s->switches, 20) ? reader_alloc(r, (size_t)s->switches + 1, sizeof *made) : NULL;
    for (int k = 0; k < s->switches && !r->bad; k++) {
        made[k].holds = reader_integer(r) != 0;
        made[k].value = reader_integer(r);
        made[k].start = reader_integer(r) != 0;
        made[k].count = reader_integer(r);
        if (!reader_check_between(made[k].value, -1, s->held) || !reader_check_between(made[k].count, 0, s->l + 1))
            reader_spoil(r, "switch %d has %d rows", k, made[k].count);
        made[k].rows = reader_places(r, r->bad ? 0 : made[k].count, 0, s->l, "a row of a switch");
    }
    s->switched = made;
}

void tables_read_frictions(Reader *r)
{
    Scene *s = r->scene;
    Friction *made
        = reader_has(r, (size_t)s->frictions, 16) ? reader_alloc(r, (size_t)s->frictions + 1, sizeof *made) : NULL;
    for (int k = 0; k < s->frictions && !r->bad; k++) {
        made[k].row = reader_integer(r);
        made[k].value = reader_integer(r);
        made[k].slip = reader_integer(r);
        made[k].shared = reader_integer(r) != 0;
        if (!reader_check_between(made[k].row, 0, s->l) || !reader_check_between(made[k].value, 0, s->held)
            || !reader_check_between(made[k].slip, 0, s->held))
            reader_spoil(r, "friction %d belongs to no constraint", k);
    }
    s->friction = made;
}

void tables_read_names(Reader *r)
{
    Scene *s = r->scene;
    const int there = reader_has(r, 8 * (size_t)s->n + 12 * (size_t)s->l, 1);
    Coordinate *coordinates = there ? reader_alloc(r, (size_t)s->n, sizeof *coordinates) : NULL;
    Row *rows = there ? reader_alloc(r, (size_t)s->l + 1, sizeof *rows) : NULL;
    const double *sizes;
    size_t count = 0;
    for (int k = 0; k < s->n && !r->bad; k++) {
        coordinates[k].name = reader_text(r);
        coordinates[k].unit = reader_text(r);
    }
    for (int k = 0; k < s->l && !r->bad; k++) {
        rows[k].name = reader_text(r);
        rows[k].direction = reader_text(r);
        rows[k].unit = reader_text(r);
    }
    sizes = reader_reals(r, &count);
    if (count != (size_t)s->l)
        reader_spoil(r, "%zu rows have a size, not %d", count, s->l);
    for (int k = 0; k < s->l && !r->bad; k++) {
        rows[k].size = sizes[k];
        if (!(sizes[k] >= 0.0 && isfinite(sizes[k])))
            reader_spoil(r, "the size of row %d is %g", k, sizes[k]);
    }
    s->nominals = reader_reals(r, &count);
    if (count != (size_t)scene_states(s))
        reader_spoil(r, "%zu states have a nominal value, not %d", count, scene_states(s));
    s->coordinates = coordinates;
    s->timed = !r->bad && s->n > 0 && !strcmp(coordinates[s->n - 1].unit, "s");
    s->rows = rows;
}

/* Read the inputs that prescribe motions of a mechanism with time as a coordinate. */
void tables_read_followed(Reader *r)
{
    Scene *s = r->scene;
    Followed *made;
    s->followed_count = s->timed ? reader_integer(r) : 0;
    if (r->bad || s->followed_count < 0 || s->followed_count > s->inputs
        || s->held < s->counted + s->timed * (1 + s->followed_count * POLYNOMIAL)) {
        reader_spoil(r, "%d inputs prescribe motion", s->followed_count);
        s->followed_count = 0;
        return;
    }
    made = reader_alloc(r, (size_t)s->followed_count + 1, sizeof *made);
    for (int k = 0; k < s->followed_count && !r->bad; k++) {
        made[k].input = reader_integer(r);
        made[k].derivatives = reader_integer(r);
        made[k].order = reader_integer(r);
        made[k].jump = reader_real(r);
        if (!r->bad
            && (!reader_check_between(made[k].derivatives, 0, 3) || !reader_check_between(made[k].order, 0, 3)
                || !(made[k].jump > 0.0) || !reader_check_between(made[k].input, 0, s->inputs - made[k].derivatives)))
            reader_spoil(r, "input %d prescribes a motion by its derivative %d", made[k].input, made[k].derivatives);
    }
    s->followed = made;
}

/* Read the interface Jacobian, the last part of a file that has one: variable, output and input of each entry. */
void tables_read_jacobian(Reader *r)
{
    Scene *s = r->scene;
    const int first = scene_variable_count(s), count = reader_integer(r);
    Variable *variables;
    Jacobian_entry *made;
    int *directions;
    if (!reader_check_between(count, 1, 1 << 22) || !reader_has(r, (size_t)count, 48)) {
        reader_spoil(r, "its interface Jacobian has %d entries", count);
        return;
    }
    variables = reader_alloc(r, (size_t)(first + count), sizeof *variables);
    made = reader_alloc(r, (size_t)count, sizeof *made);
    directions = reader_alloc(r, (size_t)s->inputs + 1, sizeof *directions); /* of each input, from 1 on; 0: none */
    if (r->bad)
        return;
    memcpy(variables, s->variables, (size_t)first * sizeof *variables);
    for (int k = 0; k < count; k++) {
        read_variable(r, OUTPUT, first + k, variables + first + k);
        made[k].output = reader_integer(r);
        made[k].input = reader_integer(r);
        if (r->bad || variables[first + k].type != REAL || !reader_check_between(made[k].output, 0, s->readings)
            || !reader_check_between(made[k].input, 0, s->inputs)) {
            reader_spoil(r, "entry %d of its interface Jacobian has no output or input", k);
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

/* Make the pattern of a dense matrix. */
static void tables_check_dense(Reader *r, Pattern *made)
{
    const int rows = made->rows, columns = made->columns;
    int *offsets, *indices;
    if ((int64_t)rows * columns > MOST_NUMBERS / MOST_ARGUMENTS)
        reader_spoil(r, "a dense matrix of %d by %d is too large", rows, columns);
    made->entries = r->bad ? 0 : rows * columns;
    made->offsets = offsets = reader_alloc(r, (size_t)columns + 1, sizeof *offsets);
    made->indices = indices = reader_alloc(r, (size_t)made->entries + 1, sizeof *indices);
    for (int c = 0; c <= columns && !r->bad; c++)
        offsets[c] = c * rows;
    for (int k = 0; k < made->entries && !r->bad; k++)
        indices[k] = k % rows;
}

void tables_read_pattern(Reader *r, Pattern *made, int rows, int columns)
{
    const int sparse = reader_integer(r);
    made->rows = rows;
    made->columns = columns;
    if (!sparse) {
        tables_check_dense(r, made);
        return;
    }
    made->offsets = reader_places(r, columns + 1, 0, INT32_MAX, "the beginning of a column");
    if (r->bad)
        return;
    for (int c = 0; c < columns; c++)
        if (made->offsets[c] > made->offsets[c + 1] || made->offsets[0] != 0)
            reader_spoil(r, "the columns of a matrix overlap");
    made->entries = made->offsets[columns];
    made->indices = reader_places(r, made->entries, 0, rows, "a row of a matrix");
}

/* The edges of each node, or the nodes of each edge. */
typedef struct {
    int *offsets, *ends;
} Lists;

static Lists make_lists(Reader *r, int count, int by_rows, const Part *parts, int part_count)
{
    Lists made;
    size_t entries = 0;
    for (int k = 0; k < part_count; k++)
        entries += (size_t)parts[k].pattern->entries;
    made.offsets = reader_alloc(r, (size_t)count + 2, sizeof *made.offsets);
    made.ends = reader_alloc(r, entries + 1, sizeof *made.ends);
    if (r->bad)
        return made;
    /* Count, sum up, then fill; until filled, offsets are stored one place further on. */
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

/* Append to `order` the nodes that are reached from its first node, breadth first, those of low degree first; mark them
   by a negative `degree`. Return their number. */
static int order_reached(const Lists *edges, const Lists *nodes, int *order, int *degree, char *passed)
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

/* Order nodes for a narrow envelope: reverse Cuthill-McKee (1969). */
void tables_order_envelope(
    Reader *r, Envelope *made, int count, int edge_count, int by_rows, const Part *parts, int part_count)
{
    const Lists edges = make_lists(r, count, by_rows, parts, part_count);
    const Lists nodes = make_lists(r, edge_count, !by_rows, parts, part_count);
    int *order = reader_alloc(r, (size_t)count + 1, sizeof *order),
        *degree = reader_alloc(r, (size_t)count + 1, sizeof *degree);
    int *place = reader_alloc(r, (size_t)count + 1, sizeof *place),
        *first = reader_alloc(r, (size_t)count + 1, sizeof *first);
    ptrdiff_t *start = reader_alloc(r, (size_t)count + 1, sizeof *start), entries = 0;
    char *passed = reader_alloc(r, (size_t)edge_count + 1, 1);
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
        /* Begin at the node reached last, which is far from k. */
        order[found] = k;
        reach = order_reached(&edges, &nodes, order + found, degree, passed);
        for (int at = found; at < found + reach; at++) {
            degree[order[at]] = -1 - degree[order[at]];
            for (int e = edges.offsets[order[at]]; e < edges.offsets[order[at] + 1]; e++)
                passed[edges.ends[e]] = 0;
        }
        order[found] = order[found + reach - 1];
        found += order_reached(&edges, &nodes, order + found, degree, passed);
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
        reader_spoil(r, "the matrices of its start have %lld numbers", (long long)entries);
    *made = (Envelope){count, place, first, start, (size_t)entries};
}

/* Read the laws of time that may jump or may not be finite. */
void tables_read_leaps(Reader *r)
{
    Scene *s = r->scene;
    Leap *made;
    const size_t count = s->timed ? reader_length(r) : 0;
    made = reader_has(r, count, 16) ? reader_alloc(r, count + 1, sizeof *made) : NULL;
    for (size_t k = 0; k < count && !r->bad; k++) {
        made[k].what = reader_text(r);
        made[k].unit = reader_text(r);
        made[k].rate_unit = reader_text(r);
        made[k].row = reader_integer(r);
        if (!r->bad && !reader_check_between(made[k].row, -1, s->l))
            reader_spoil(r, "a law belongs to constraint %d, which it does not have", made[k].row);
    }
    s->leaps = made;
    s->leap_count = (int)count;
    function_is_shaped(r, "laws", s->laws, count > 0, 3, 1, s->n, s->n, s->own + s->held, 3 * (int)count);
}
