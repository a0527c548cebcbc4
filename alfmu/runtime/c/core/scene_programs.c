#include "scene_programs.h"

#include "instance.h"
#include "layout.h"
#include "operations.h"
#include "scene.h"
#include "scene_reader.h"

static int is_within(const Reader *r, int64_t place, int64_t length)
{
    return place >= 0 && length >= 0 && place + length <= (int64_t)r->scene->size + r->scene->workspace;
}

static void check_program(Reader *r, const Word *code, size_t words, int depth)
{
    const Scene *s = r->scene;
    size_t at = 0;
    if (depth > DEEPEST)
        reader_spoil(r, "its choices and loops are too deep");
    while (at < words && !r->bad) {
        const Word *c = code + at + 1;
        const size_t left = words - at - 1;
        switch (code[at]) {
        case CALL_CODE: {
            const Function *f = left ? s->functions + c[0] : NULL;
            if (!left || !reader_check_between(c[0], 0, s->function_count)
                || left - 1 < (size_t)(f->inputs + f->outputs)) {
                reader_spoil(r, "a program calls an unknown function");
                return;
            }
            for (int k = 0; k < f->inputs + f->outputs; k++)
                if (!is_within(r, c[1 + k], f->lengths[k]))
                    reader_spoil(r, "a program reads or writes outside the memory");
            at += 2 + (size_t)(f->inputs + f->outputs);
            break;
        }
        case CHOICE_CODE:
            if (left < 3 || !is_within(r, c[0], 1) || c[1] < 0 || c[2] < 0 || (size_t)c[1] > left - 3
                || (size_t)c[2] > left - 3 - (size_t)c[1]) {
                reader_spoil(r, "a choice of a program is damaged");
                return;
            }
            check_program(r, c + 3, (size_t)c[1], depth + 1);
            check_program(r, c + 3 + c[1], (size_t)c[2], depth + 1);
            at += 4 + (size_t)c[1] + (size_t)c[2];
            break;
        case LOOP_CODE:
            if (left < 3 || !is_within(r, c[0], 1) || (c[1] < 0 && !is_within(r, -1 - (int64_t)c[1], 1)) || c[2] < 0
                || (size_t)c[2] > left - 3) {
                reader_spoil(r, "a loop of a program is damaged");
                return;
            }
            check_program(r, c + 3, (size_t)c[2], depth + 1);
            at += 4 + (size_t)c[2];
            break;
        case FACTOR_CODE: {
            int64_t side, parts;
            if (left < 6 || !reader_check_between(c[0], 1, 10000) || !reader_check_between(c[1], 1, 100)
                || !reader_check_between(c[2], 1, 100)) {
                reader_spoil(r, "a factorisation of a program is damaged");
                return;
            }
            side = (int64_t)c[0] * c[1];
            parts = (int64_t)c[1] * c[2];
            if (parts > MOST_ARGUMENTS || left < 6 + (size_t)parts || !is_within(r, c[3], c[1] * parts)
                || !is_within(r, c[4 + parts], side * side) || !is_within(r, c[5 + parts], side)) {
                reader_spoil(r, "a factorisation of a program is damaged");
                return;
            }
            for (int64_t k = 0; k < parts; k++)
                if (!is_within(r, c[4 + k], (int64_t)c[0] * c[0]))
                    reader_spoil(r, "a program reads or writes outside the memory");
            at += 7 + (size_t)parts;
            break;
        }
        case SOLVE_CODE: {
            int64_t side;
            if (left < 5 || !reader_check_between(c[0], 1, 10000) || !reader_check_between(c[1], 1, MOST_ARGUMENTS)
                || left < 5 + (size_t)c[1]) {
                reader_spoil(r, "a solution of a program is damaged");
                return;
            }
            side = (int64_t)c[0] * c[1];
            if (!is_within(r, c[2], side * side) || !is_within(r, c[3], side) || !is_within(r, c[4 + c[1]], side))
                reader_spoil(r, "a program reads or writes outside the memory");
            for (int k = 0; k < c[1]; k++)
                if (!is_within(r, c[4 + k], c[0]))
                    reader_spoil(r, "a program reads or writes outside the memory");
            at += 6 + (size_t)c[1];
            break;
        }
        case LEAST_NORM_CODE:
            if (left < 4 || !reader_check_between(c[0], 1, MOST_UNKNOWNS)) {
                reader_spoil(r, "a dense system of a program is damaged");
                return;
            }
            if (!is_within(r, c[1], (int64_t)c[0] * c[0]) || !is_within(r, c[2], c[0]) || !is_within(r, c[3], c[0]))
                reader_spoil(r, "a program reads or writes outside the memory");
            else if (c[0] > r->scene->dense)
                r->scene->dense = c[0];
            at += 5;
            break;
        case LANES_CODE: {
            const Function *f = left > 1 ? s->functions + c[1] : NULL;
            if (left < 2 || c[0] < 1 || !reader_check_between(c[1], 0, s->function_count)
                || (left - 2) / (unsigned)c[0] < (size_t)(f->inputs + f->outputs)) {
                reader_spoil(r, "a program calls an unknown function");
                return;
            }
            c += 2;
            for (int32_t lane = 0; lane < code[at + 1]; lane++)
                for (int k = 0; k < f->inputs + f->outputs; k++)
                    if (!is_within(r, *c++, f->lengths[k]))
                        reader_spoil(r, "a program reads or writes outside the memory");
            at = (size_t)(c - code);
            if (f->narrow && f->registers > s->lane_registers)
                r->scene->lane_registers = f->registers;
            break;
        }
        default:
            reader_spoil(r, "a program has the unknown step %d", (int)code[at]);
        }
    }
}

void programs_read(Reader *r)
{
    Scene *s = r->scene;
    const size_t count = reader_length(r);
    Program *made = reader_has(r, count, 4) ? reader_alloc(r, count + 1, sizeof *made) : NULL;
    for (size_t k = 0; k < count && !r->bad; k++) {
        made[k].code = reader_integers(r, -1, &made[k].words);
        if (!r->bad)
            check_program(r, made[k].code, made[k].words, 0);
    }
    s->programs = made;
    s->program_count = (int)count;
#define KNOWN(name) \
    if (!reader_check_between(s->name, -1, s->program_count)) \
        reader_spoil(r, "there is no program " #name);
    SCENE_PROGRAMS(KNOWN)
#undef KNOWN
    if (s->quick < 0 || s->careful < 0 || s->instant < 0 || (s->method && s->method_step < 0)
        || (s->stiff_step >= 0 && s->method != 1)
        || (s->short_step >= 0 && (s->method != 1 || s->short_cost < 1 || s->method_cost < 1))
        || (s->l && ((s->move < 0) != (s->close < 0) || (s->switches && s->impact < 0))))
        reader_spoil(r, "a program is missing");
}
