#include "scene_sizes.h"

#include "layout.h"
#include "scene.h"

int scene_variable_count(const Scene *s)
{
    return scene_first_output(s) + s->outputs + s->entries;
}

/* Return the reference of the first output. */
int scene_first_output(const Scene *s)
{
    return s->parameters + s->choices + s->inputs + s->switches;
}

/* Return the place, among the settings, of the direction of a start in a singular position. */
int scene_way(const Scene *s)
{
    return SETTINGS + 2 * s->l + s->n + s->compliances;
}

/* Return the place, among the settings, of the matrix that replaces penalties if redundant constraints brake. */
int scene_matrix(const Scene *s)
{
    return scene_way(s) + (s->l ? s->n : 0);
}

int scene_settings_length(const Scene *s)
{
    return scene_matrix(s) + (s->brakes ? s->l * s->l : 0);
}

size_t scene_state_length(const Scene *s)
{
    return (size_t)s->near + 1;
}

/* States lie between the work and the time. */
int scene_states(const Scene *s)
{
    return s->time - s->work - 1;
}

int scene_driven(const Scene *s)
{
    return s->inputs + scene_states(s);
}

int scene_exchanged(const Scene *s)
{
    return s->exchange < 0 ? 0 : 2 * (s->n - s->timed) + scene_states(s);
}

int scene_exchange_variables(const Scene *s)
{
    return s->exchange < 0 ? 0 : 2 * scene_exchanged(s) + s->frictions;
}

size_t scene_peaks_length(const Scene *s)
{
    return s->peaks ? (size_t)s->peaks + STATE_BEFORE + 2 * (size_t)s->n : 0;
}
