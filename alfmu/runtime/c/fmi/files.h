/* Paths and files, whatever the system. */

#ifndef ALFMU_FILES_H
#define ALFMU_FILES_H

#include <stddef.h>

#include "internal_begin.h"

#define LONGEST_PATH 4096

/* Path (LONGEST_PATH) of a URI such as file:///tmp/a%20b; other texts are paths already. */
void files_path_of(const char *uri, char *path);

/* The folder of resources as seen from this library, which is in binaries/<platform>; empty where it is not known. */
void files_own_resources(char *path);

/* The content of a file, to be freed; NULL where it cannot be read. */
unsigned char *files_read(const char *folder, const char *name, size_t *size);

#include "internal_end.h"

#endif
