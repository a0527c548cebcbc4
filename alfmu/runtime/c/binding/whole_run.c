#include "whole_run.h"

#include "begin.h"
#include "outputs.h"
#include "run.h"

static Outcome set_inputs(Instance *i, const Run *r, long row)
{
    Outcome outcome = DONE;
    for (int k = 0; k < r->input_count && outcome == DONE; k++)
        outcome = instance_set(i, r->inputs[k], r->table[row * r->input_count + k]);
    return outcome;
}

long whole_run_make(Instance *i, const Run *r, long *done, Outcome *outcome)
{
    long row = 0;
    *outcome = DONE;
    while (row < r->count && *outcome == DONE) {
        if (row > 0) {
            *done = row - 1;
            i->looks = -1; /* The first internal step then calls `go_on`. */
            *outcome = instance_step(i, r->times[row - 1], r->times[row] - r->times[row - 1]);
        }
        if (*outcome == DONE)
            *outcome = set_inputs(i, r, row);
        if (*outcome == DONE && row == 0 && !i->flags.initialized)
            *outcome = instance_initialize(i);
        i->flags.phase = i->flags.initialized ? STEPPING : INITIALIZING;
        if (*outcome == DONE)
            *outcome = outputs_get_many(i, r->wanted, r->wanted_count, r->values + row * r->wanted_count);
        row += *outcome == DONE;
    }
    return row;
}
