/* Paths and files, whatever the system. */

#ifndef ALFMU_FILES_H
#define ALFMU_FILES_H

#include <stddef.h>

/* Also where an importer compiles this: other libraries have such names too (glibc: advance). */
#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility push(hidden)
#endif

#define LONGEST_PATH 4096

/* The path (LONGEST_PATH) that a URI such as file:///tmp/a%20b names; what is no URI is a path already. */
void path_of(const char *uri, char *path);

/* The folder of resources as seen from this library, which is in binaries/<platform>; empty where it is not known. */
void own_resources(char *path);

/* The content of a file, to be freed; NULL where it cannot be read. */
unsigned char *read_file(const char *folder, const char *name, size_t *size);

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility pop
#endif

#endif
