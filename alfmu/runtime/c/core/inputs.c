#include "inputs.h"

#include "instance.h"
#include "scene.h"

#define MOST_POINTS 3 /* of a polynomial through past inputs */

/* Give the inputs and their rates at a time within the communication step from `from`, as programs have them: an input
   follows the derivative that the host gave, else the polynomial of solver.input_order through its last values. */
void inputs_within(const Instance *i, double from, double time, double *u, double *du)
{
    const Scene *s = i->scene;
    const double *past = i->m + s->past, *rows[MOST_POINTS] = {i->m + s->u};
    const int kept = s->past_size ? (s->past_size - 1) / (1 + s->inputs) : 0;
    const int known = kept ? (int)past[0] : 0, order = kept ? (int)i->values[s->input_order] : 0;
    double times[MOST_POINTS] = {i->within && known ? past[1] : from};
    int points = 1;
    for (int k = 0; k < known && k < kept && points <= order && points < MOST_POINTS; k++)
        if (past[1 + k] < times[0]) { /* The first one may be that at `from`. */
            times[points] = past[1 + k];
            rows[points++] = past + 1 + kept + k * s->inputs;
        }
    for (int k = 0; k < s->inputs; k++) {
        const double slope = i->slopes[1 + k];
        u[k] = du[k] = 0.0;
        if (isfinite(slope)) {
            du[k] = slope;
            u[k] = rows[0][k] + slope * (time - from);
            continue;
        }
        for (int a = 0; a < points; a++) {
            double weight = 1.0, rate = 0.0;
            for (int b = 0; b < points; b++)
                if (b != a) {
                    const double apart = times[a] - times[b];
                    rate = (rate * (time - times[b]) + weight) / apart;
                    weight *= (time - times[b]) / apart;
                }
            u[k] += weight * rows[a][k];
            du[k] += rate * rows[a][k];
        }
    }
}
