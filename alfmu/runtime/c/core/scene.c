/* Loads a scene from its file, and checks everything in it once, so that nothing has to be checked while it runs.

   A file is `ALFMU\r\n\x1a`, the version, the length of the whole, a check sum of all bytes after it, an identity, and
   the body; all numbers are little-endian. */

#include "scene.h"

#include <stdio.h>
#include <stdlib.h>

#include "layout.h"
#include "scene_functions.h"
#include "scene_programs.h"
#include "scene_reader.h"
#include "scene_sizes.h"
#include "scene_tables.h"

/* Read the limits of stops. */
static void read_limits(Reader *r)
{
    Scene *s = r->scene;
    const Function *f = reader_check_between(s->stops, 0, s->function_count) ? s->functions + s->stops : NULL;
    const int count = f && f->inputs == 2 && f->outputs == 2 ? f->lengths[2] : 0;
    Limit *made = reader_has(r, (size_t)count, 8) ? reader_alloc(r, (size_t)count + 1, sizeof *made) : NULL;
    for (int k = 0; k < count && !r->bad; k++) {
        made[k].name = reader_text(r);
        made[k].unit = reader_text(r);
    }
    s->limited = made;
    s->limit_count = count;
    function_is_shaped(r, "stops", s->stops, 0, 2, 2, s->n, s->own + s->held, count,
        (int64_t)count * s->n < INT32_MAX ? count * s->n : 0);
}

/* Check that the fields that the runtime accesses are within the memory. */
static void check_memory(Reader *r)
{
    const Scene *s = r->scene;
    const int states = scene_states(s), state = 2 * s->n + s->angles + states + 6;
    const struct {
        int place, length;
    } fields[] = {{s->z, state}, {s->after, state}, {s->begin, state}, {s->u, s->inputs}, {s->p, s->own + s->held},
        {s->k, scene_settings_length(s)}, {s->dt, 1}, {s->control, CONTROL}, {s->tally, TALLY}, {s->pace, PACE},
        {s->past, s->past_size}, {s->seen, s->seen_size}},
      handed[] = {{s->most, 1}, {s->patient, 1}, {s->slopes, s->inputs + 1}, {s->within, 1}, {s->q, s->n}, {s->v, s->n},
          {s->watch0, WATCH}, {s->watch1, WATCH}, {s->watch2, WATCH}, {s->watch3, WATCH}, {s->watch4, WATCH},
          {s->q1, s->n}, {s->q2, s->n}, {s->q3, s->n}, {s->q4, s->n}, {s->v1, s->n}, {s->v2, s->n}, {s->v3, s->n},
          {s->v4, s->n}, {s->again, 1}, {s->stabilisation, 2}, {s->projects, 1}, {s->of_least_norm, 1},
          {s->on_branch, 1}, {s->onward, 1},
#define CHOSEN(name) {s->name, 1},
          SCENE_OTHERS(CHOSEN)
#undef CHOSEN
              {s->struck, s->n},
          {s->impulse, s->l}, {s->lost, 1}, {s->read_watch, WATCH}, {s->grip, 3 * s->frictions + 2},
          {s->exchange < 0 ? 0 : s->exchange, s->n}};
    if (!reader_check_between(s->size, 1, MOST_NUMBERS) || !reader_check_between(s->workspace, 0, MOST_NUMBERS))
        reader_spoil(r, "its memory has %d numbers", s->size);
    if (s->counted > s->angles || s->counted > s->held)
        reader_spoil(r, "its angles contradict each other");
    if (s->work != 2 * s->n + s->angles || s->trouble != s->time + 1 || s->change != s->time + 2
        || s->near != s->time + 4)
        reader_spoil(r, "its state contradicts itself");
    if (!reader_check_between(s->monitor_position, -1, s->outputs - s->event_count)
        || !reader_check_between(s->monitor_velocity, -1, s->outputs - s->event_count)
        || !reader_check_between(s->monitor_energy, -1, s->outputs - s->event_count)
        || !reader_check_between(s->monitor_iterations, -1, s->outputs - s->event_count)
        || !reader_check_between(s->monitor_step_error, -1, s->outputs - s->event_count))
        reader_spoil(r, "its monitors contradict each other");
    if (s->seen_size < SEEN + s->outputs - s->event_count || s->readings > s->outputs - s->event_count)
        reader_spoil(r, "its outputs contradict each other");
    if (s->pace > s->past || (int64_t)s->tally + TALLY > s->pace || s->dt > s->tally)
        reader_spoil(r, "its fields are not in order");
    for (size_t k = 0; k < sizeof fields / sizeof *fields; k++)
        if (fields[k].place < 0 || fields[k].place + (int64_t)fields[k].length > s->size)
            reader_spoil(r, "a field is outside its memory");
    for (size_t k = 0; k < sizeof handed / sizeof *handed; k++)
        if (handed[k].place < 0 || handed[k].place + (int64_t)handed[k].length > s->workspace)
            reader_spoil(r, "a value is outside its workspace");
}

/* Continue a check sum: CRC-32 as in zip archives, four bytes at a time. */
uint32_t scene_check_sum(uint32_t sum, const unsigned char *at, size_t count)
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
        sum ^= at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
        sum = table[3][sum & 255] ^ table[2][sum >> 8 & 255] ^ table[1][sum >> 16 & 255] ^ table[0][sum >> 24];
    }
    for (; count; count--, at++)
        sum = table[0][(sum ^ *at) & 255] ^ sum >> 8;
    return sum;
}

/* Check that this library has the features that the scene needs; one built for a scene leaves out others. */
static void check_features(Reader *r)
{
    const struct {
        int needed;
        const char *what;
    } absent[] = {
#ifdef WITHOUT_FRICTION
        {r->scene->frictions, "dry friction"},
#endif
#ifdef WITHOUT_MOVING_INPUTS
        {r->scene->followed_count, "inputs that prescribe motion"},
#endif
#ifdef WITHOUT_SWITCHES
        {r->scene->switches, "Boolean inputs"},
#endif
#ifdef WITHOUT_BREAKS
        {r->scene->break_count, "forces that jump"},
#endif
#ifdef WITHOUT_LAWS
        {r->scene->leap_count, "laws of motion"},
#endif
#ifdef WITHOUT_PEAKS
        {r->scene->peaks, "peaks"},
#endif
#ifdef WITHOUT_ERROR_CONTROL
        {r->scene->method, "this solver.method"},
#endif
#ifdef WITHOUT_INTERFACE_JACOBIAN
        {r->scene->entries, "an interface Jacobian"},
#endif
        {0, ""}};
    for (size_t k = 0; k < sizeof absent / sizeof *absent; k++)
        if (absent[k].needed)
            reader_spoil(r, "this library was compiled for a scene without %s", absent[k].what);
}

static void read_body(Reader *r)
{
    Scene *s = r->scene;
    size_t count = 0;
    s->name = reader_text(r);
    tables_read_numbers(r);
    if (r->bad)
        return;
    check_memory(r);
    tables_read_variables(r);
    tables_read_choices(r);
    tables_read_switches(r);
    tables_read_frictions(r);
    s->impulse_rows = reader_places(r, s->impulses, 0, s->l, "a row of an impulse");
    s->event_places = reader_places(r, s->event_count, 0, s->impulses + 1 + s->peaks, "the place of an impulse");
    s->peak_parts = reader_places(r, 3 * s->peaks, -1, s->readings, "a part of a peak");
    s->angle_starts = reader_places(r, s->angles, -1, s->starts, "the start of an angle");
    s->tied = reader_places(r, s->ties, 0, s->starts, "a start value");
    s->break_levels = reader_places(r, s->break_count, 0, s->break_count, "a level");
    if (!r->bad)
        tables_read_names(r);
    s->normal = reader_reals(r, &count);
    if (count < (size_t)(TRIES > RANKED ? TRIES : RANKED) * (size_t)s->n)
        reader_spoil(r, "it has %zu standard normal numbers", count);
    s->readiness = reader_reals(r, &count);
    if (count != (size_t)s->n)
        reader_spoil(r, "it has %zu weights of %d coordinates", count, s->n);
    if (r->bad)
        return;
    tables_read_pattern(r, &s->mass, s->n, s->n);
    tables_read_pattern(r, &s->constraint, s->l, s->n);
    tables_read_pattern(r, &s->gaps, s->l, s->n);
    tables_read_pattern(r, &s->tie_rows, s->ties, s->n);
    if (!r->bad) {
        const Part rows[] = {{&s->constraint, 0}, {&s->gaps, 0}, {&s->tie_rows, s->l}};
        const Part masses[] = {{&s->constraint, 0}, {&s->mass, s->l}};
        tables_order_envelope(r, &s->closing, s->l + s->ties, s->n, 1, rows, 3);
        tables_order_envelope(r, &s->holding, s->n, s->l + s->n, 0, masses, 2);
    }
    functions_read(r);
    programs_read(r);
    if (!r->bad)
        tables_read_followed(r);
    if (!r->bad)
        tables_read_leaps(r);
    if (!r->bad)
        read_limits(r);
    if (!r->bad && r->at != r->end)
        tables_read_jacobian(r);
    if (!r->bad && r->at != r->end)
        reader_spoil(r, "%zu bytes follow its end", (size_t)(r->end - r->at));
    check_features(r);
}

Scene *scene_load(const unsigned char *bytes, size_t size, char *why, size_t why_size)
{
    static const char magic[] = "ALFMU\r\n\x1a";
    Scene *s = calloc(1, sizeof *s);
    Reader r = {bytes, bytes + size, s, why, why_size, 0, 0};
    if (!s) {
        snprintf(why, why_size, "there is not enough memory for it");
        return NULL;
    }
    if (size < HEAD || memcmp(bytes, magic, sizeof magic - 1))
        reader_spoil(&r, "it is not a scene file");
    else if (bytes_little(bytes + 8, 4) != SCENE_VERSION)
        reader_spoil(&r, "its version is %u and this runtime reads %u; export it again",
            (unsigned)bytes_little(bytes + 8, 4), (unsigned)SCENE_VERSION);
    else if (bytes_little(bytes + 12, 4) != size)
        reader_spoil(&r, "it has %zu bytes instead of %u", size, (unsigned)bytes_little(bytes + 12, 4));
    else if (bytes_little(bytes + 16, 8) != (uint32_t)~scene_check_sum(CHECK_BEGIN, bytes + 24, size - 24))
        reader_spoil(&r, "its check sum does not agree; it is damaged");
    else {
        memcpy(s->guid, bytes + 24, sizeof s->guid - 1);
        s->body = ~scene_check_sum(CHECK_BEGIN, bytes + HEAD, size - HEAD);
        r.at = bytes + HEAD;
        read_body(&r);
    }
    if (r.bad) {
        scene_free(s);
        return NULL;
    }
    return s;
}

static void take_lanes(Scene *s, Function *own, Compiled *const *functions, int spare)
{
    for (int k = 0; k < s->function_count; k++) {
        int rows = spare;
        for (int j = 0; j < own[k].inputs + own[k].outputs; j++)
            rows += own[k].lengths[j];
        if (rows > s->lane_rows)
            s->lane_rows = rows;
        own[k].in_lanes = functions[k];
    }
}

int scene_compiled(Scene *s, Compiled *const *functions, int count, int spare, const char *identity, int in_lanes)
{
    Function *own = (Function *)s->functions; /* allocated by the scene itself */
    char body[9];
    snprintf(body, sizeof body, "%08x", s->body);
    if (count != s->function_count || !reader_check_between(spare, 0, MOST_NUMBERS) || strcmp(identity, body))
        return 0;
    if (in_lanes) {
        take_lanes(s, own, functions, spare);
        return 1;
    }
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
