/* Settings of a run, passed to the programs of the scene. */

#pragma once

#include "instance.h"
#include "scene.h"

int settings_instant(const Scene *s);
int settings_formulation(const Instance *i);
int settings_project(const Instance *i);
int settings_all_serve(const Instance *i);
int penalty_is_given(const Instance *i);
const char *settings_or_penalty(const Instance *i);
const char *settings_or_compliances(const Instance *i, char *text, size_t size);
double settings_internal_steps(const Instance *i, double h);
int settings_moving(const Instance *i);
const char *settings_or_shorter(const Instance *i);
const char *settings_remedy(const Instance *i);
void settings_upload_arguments(Instance *i);
void settings_set_penalties(Instance *i);
int settings_continue(const Instance *i);
int settings_method(const Instance *i);
void settings_upload(Instance *i);
void settings_count_turns(Instance *i);
void settings_follow_turns(Instance *i);
void settings_upload_parameters(Instance *i);
void settings_in_force(const Instance *i, const double *on, unsigned char *held);
int settings_usual(Instance *i);
const char *settings_method_name(const Instance *i);
Outcome settings_update_rank(Instance *i, const double *q, const double *v);
double settings_margin(Instance *i, const double *q);
