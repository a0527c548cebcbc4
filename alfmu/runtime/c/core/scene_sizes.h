/* Sizes that follow from the tables of a scene. */

#pragma once

#include "scene.h"

/* Values stored after the peaks: whether the start of the previous step is known, its time, q and v. */
enum { KNOWN_BEFORE, TIME_BEFORE, STATE_BEFORE };

int scene_variable_count(const Scene *s);
int scene_first_output(const Scene *s);
int scene_way(const Scene *s);
int scene_matrix(const Scene *s);
int scene_settings_length(const Scene *s);
size_t scene_state_length(const Scene *s);

/* Number of first-order states, and length of u in the equations: inputs, followed by states. */
int scene_states(const Scene *s);

int scene_driven(const Scene *s);

/* Number of states that an importer integrates in Model Exchange, 0 where the scene is for co-simulation alone. */
int scene_exchanged(const Scene *s);

/* Number of variables of Model Exchange: states, their rates, and event indicators. */
int scene_exchange_variables(const Scene *s);

size_t scene_peaks_length(const Scene *s);
