/* Changes of the constraints in force: ranks, impacts, penalties. */

#ifndef ALFMU_TOPOLOGY_H
#define ALFMU_TOPOLOGY_H

#include "instance.h"

#include "internal_begin.h"

Outcome topology_update_rank(Instance *i, const double *q, const double *v);
Outcome topology_change(Instance *i, const double *on);
Outcome instance_penalize(Instance *i, const double *penalties);

#include "internal_end.h"

#endif
