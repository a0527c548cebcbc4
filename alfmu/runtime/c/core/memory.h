/* Memory of instances. The C that `alfmu export --kind source` writes has the memory.h of the folder `source` in place
   of this one, which takes it from a static arena. */

#ifndef ALFMU_MEMORY_H
#define ALFMU_MEMORY_H

#include <stddef.h>
#include <stdlib.h>

/* Memory that is zero, to be given back; NULL where there is none. */
static inline void *memory_take(size_t count, size_t size)
{
    return calloc(count, size);
}

static inline void memory_give(void *taken)
{
    free(taken);
}

#endif
