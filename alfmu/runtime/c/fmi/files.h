/* Paths and files, whatever the system. */

#ifndef ALFMU_FILES_H
#define ALFMU_FILES_H

#include <stddef.h>

#include "internal_begin.h"

#define LONGEST_PATH 4096

/* The path (LONGEST_PATH) that a URI such as file:///tmp/a%20b names; what is no URI is a path already. */
void files_path_of(const char *uri, char *path);

/* The folder of resources as seen from this library, which is in binaries/<platform>; empty where it is not known. */
void files_own_resources(char *path);

/* The content of a file, to be freed; NULL where it cannot be read. */
unsigned char *files_read(const char *folder, const char *name, size_t *size);

#include "internal_end.h"

#endif
