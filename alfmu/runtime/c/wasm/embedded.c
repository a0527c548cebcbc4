/* The scene of an FMU in WebAssembly: `with_scene` of embedding.py appends its size and its bytes to the initial memory
   of the module. */

#include "files.h"

#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

extern unsigned char __heap_end; /* defined by the linker: end of the initial memory */

#define PAGE 65536u

void files_path_of(const char *uri, char *path)
{
    (void)uri;
    *path = 0;
}

void files_own_resources(char *path)
{
    *path = 0;
}

unsigned char *files_read(const char *folder, const char *name, size_t *size)
{
    const unsigned char *place = &__heap_end;
    unsigned char *bytes = NULL;
    uint32_t length = 0;
    (void)folder;
    (void)name;
    if (__builtin_wasm_memory_size(0) * PAGE > (uintptr_t)place)
        memcpy(&length, place, sizeof length);
    if (length && (bytes = malloc(length)) && (*size = length))
        memcpy(bytes, place + sizeof length, length);
    return bytes;
}
