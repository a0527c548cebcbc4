/* Paths and files, whatever the system. */

#pragma once

#include "baseline.h"

#define LONGEST_PATH 4096

/* Return the path (LONGEST_PATH) of a URI such as file:///tmp/a%20b; other texts are paths already. */
void files_path_of(const char *uri, char *path);

/* Find the resources folder from the path of this library, which is in binaries/<platform>; empty if unknown. */
void files_own_resources(char *path);

/* Return the content of a file, which the caller frees; NULL if it cannot be read. */
unsigned char *files_read(const char *folder, const char *name, size_t *size);
