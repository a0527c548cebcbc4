#include "input_derivatives.h"

#include "driving_inputs.h"
#include "gradient.h"
#include "lanes.h"
#include "layout.h"
#include "record.h"
#include "scene.h"

/* The polynomial of a driving input is linear in these numbers: the input's values, coefficients, history. */
#define OF_INPUT 3
#define AIM_NUMBERS (OF_INPUT + POLYNOMIAL - 1 + HEARD_POINTS)

/* Apply this linear map to `x` (AIM_NUMBERS). */
static void differentiate_aim(const Followed *f, const double *saved, double *x)
{
    double c[POLYNOMIAL], heard[HEARD];
    Given g = {{0.0, 0.0, 0.0}, (int)saved[SAVED_LEVEL]};
    c[0] = saved[SAVED_FROM];
    memcpy(c + 1, x + OF_INPUT, (POLYNOMIAL - 1) * sizeof *c);
    memcpy(heard, saved, sizeof heard);
    memcpy(heard + VALUES, x + OF_INPUT + POLYNOMIAL - 1, HEARD_POINTS * sizeof *heard);
    for (int k = 0; k <= f->derivatives; k++)
        g.value[k] = x[k];
    input_aim(f, &g, c, heard, saved[SAVED_START], saved[SAVED_STEP], saved[SAVED_LITTLE]);
    memcpy(x + OF_INPUT, c + 1, (POLYNOMIAL - 1) * sizeof *c);
    memcpy(x + OF_INPUT + POLYNOMIAL - 1, heard + VALUES, HEARD_POINTS * sizeof *heard);
}

/* Return the place of one of these numbers; -1 if the input has no such derivative. */
static int32_t aim_place(const Followed *f, const int32_t *words, int k)
{
    if (k < OF_INPUT)
        return k <= f->derivatives ? words[2] + k : -1;
    k -= OF_INPUT;
    return k < POLYNOMIAL - 1 ? words[0] + 1 + k : words[1] + VALUES + (k - (POLYNOMIAL - 1));
}

void aimed_tangents(Gradient *g, const Entry *e)
{
    const Followed *f = g->instance->scene->followed + e->what;
    const int32_t *words = g->tape->words + e->words;
    const double *saved = g->tape->numbers + e->numbers;
    for (int block = 0; block < g->blocks; block++)
        for (int lane = 0; lane < LANES; lane++) {
            Lanes *t = g->tangents + (size_t)block * g->places;
            double x[AIM_NUMBERS];
            for (int k = 0; k < AIM_NUMBERS; k++) {
                const int32_t place = aim_place(f, words, k);
                x[k] = place < 0 ? 0.0 : t[place].lane[lane];
            }
            differentiate_aim(f, saved, x);
            for (int k = OF_INPUT; k < AIM_NUMBERS; k++)
                t[aim_place(f, words, k)].lane[lane] = x[k];
        }
}

void aimed_adjoints(Gradient *g, const Entry *e)
{
    const Followed *f = g->instance->scene->followed + e->what;
    const int32_t *words = g->tape->words + e->words;
    const double *saved = g->tape->numbers + e->numbers;
    double weights[AIM_NUMBERS] = {0.0};
    for (int k = OF_INPUT; k < AIM_NUMBERS; k++) {
        weights[k] = g->adjoints[aim_place(f, words, k)];
        g->adjoints[aim_place(f, words, k)] = 0.0;
    }
    for (int each = 0; each < AIM_NUMBERS; each++) {
        const int32_t place = aim_place(f, words, each);
        double x[AIM_NUMBERS] = {0.0}, sum = 0.0;
        if (place < 0)
            continue;
        x[each] = 1.0;
        differentiate_aim(f, saved, x);
        for (int k = OF_INPUT; k < AIM_NUMBERS; k++)
            sum += weights[k] * x[k];
        g->adjoints[place] += sum;
    }
}
