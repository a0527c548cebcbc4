/* Saving, checking and restoring the state of an instance. */

#pragma once

#include "instance.h"

void instance_remember(Instance *i);
void instance_go_back(Instance *i);
size_t state_size(const Instance *i);
void state_save(const Instance *i, unsigned char *state);
int state_whole(const Instance *i, const unsigned char *state, size_t size);
Outcome state_restore(Instance *i, const unsigned char *state, size_t size);
