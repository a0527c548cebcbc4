/* Files of an FMU: in the resources folder that the host names, or relative to this library. In a file of its own, as
   windows.h declares common names. */

#if !defined(_GNU_SOURCE)
#define _GNU_SOURCE /* dladdr, dl_iterate_phdr */
#endif

#include "files.h"

#include <stdio.h>
#include <stdlib.h>

#if defined(_WIN32)
#define WIN32_LEAN_AND_MEAN
#include <windows.h>
#elif defined(__linux__)
#include <link.h>
#else
#include <dlfcn.h>
#endif

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility push(hidden) /* for importers that compile this file without options */
#endif

#define LARGEST_FILE (1 << 30)

static int digit_of(char c)
{
    return c >= '0' && c <= '9' ? c - '0'
        : c >= 'a' && c <= 'f'  ? c - 'a' + 10
        : c >= 'A' && c <= 'F'  ? c - 'A' + 10
                                : -1;
}

/* Return the path of a URI such as file:///tmp/a%20b; other texts are paths already. */
void files_path_of(const char *uri, char *path)
{
    size_t length = 0;
    int escaped = 0;
    if (!strncmp(uri, "file:", 5)) {
        escaped = 1;
        uri += 5;
        if (!strncmp(uri, "//", 2)) {
            uri += 2;
            if (!strncmp(uri, "localhost/", 10))
                uri += 9;
        }
#if defined(_WIN32)
        if (uri[0] == '/' && uri[1] && uri[2] == ':')
            uri++;
#endif
    }
    for (; *uri && length + 1 < LONGEST_PATH; uri++) {
        if (escaped && *uri == '%' && digit_of(uri[1]) >= 0 && digit_of(uri[2]) >= 0) {
            path[length++] = (char)(digit_of(uri[1]) * 16 + digit_of(uri[2]));
            uri += 2;
        } else
            path[length++] = *uri;
    }
    path[length] = 0;
}

static FILE *open_file(const char *path)
{
#if defined(_WIN32)
    wchar_t wide[LONGEST_PATH];
    if (!MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, LONGEST_PATH))
        return NULL;
    return _wfopen(wide, L"rb");
#else
    return fopen(path, "rb");
#endif
}

#if defined(__linux__)
/* Path of the library that contains an address; dladdr is in different libraries in different versions of glibc. */
typedef struct {
    uintptr_t address;
    char *path;
} Sought;

static int look_into(struct dl_phdr_info *info, size_t size, void *sought)
{
    const Sought *s = sought;
    (void)size;
    for (int k = 0; k < info->dlpi_phnum; k++) {
        const uintptr_t begin = info->dlpi_addr + info->dlpi_phdr[k].p_vaddr;
        if (info->dlpi_phdr[k].p_type == PT_LOAD && s->address - begin < info->dlpi_phdr[k].p_memsz) {
            if (strlen(info->dlpi_name) < LONGEST_PATH)
                strcpy(s->path, info->dlpi_name);
            return 1;
        }
    }
    return 0;
}

#endif

void files_own_resources(char *path)
{
    char *end = path;
    *path = 0;
#if defined(_WIN32)
    {
        HMODULE module;
        wchar_t wide[LONGEST_PATH];
        if (!GetModuleHandleExW(
                GET_MODULE_HANDLE_EX_FLAG_FROM_ADDRESS | GET_MODULE_HANDLE_EX_FLAG_UNCHANGED_REFCOUNT,
                (LPCWSTR)(void *)files_own_resources, &module)
            || !GetModuleFileNameW(module, wide, LONGEST_PATH)
            || !WideCharToMultiByte(CP_UTF8, 0, wide, -1, path, LONGEST_PATH, NULL, NULL))
            *path = 0;
        for (char *at = path; *at; at++)
            *at = *at == '\\' ? '/' : *at;
    }
#elif defined(__linux__)
    {
        static const int here; /* an address in this library */
        Sought sought = {(uintptr_t)&here, path};
        dl_iterate_phdr(look_into, &sought);
    }
#else
    {
        Dl_info info;
        static const int here; /* an address in this library */
        if (dladdr((const void *)&here, &info) && info.dli_fname && strlen(info.dli_fname) < LONGEST_PATH)
            strcpy(path, info.dli_fname);
    }
#endif
    for (int k = 0; k < 3; k++) {
        end = (strrchr)(path, '/'); /* the function: the macro of its name in new headers is not C99 */
        if (!end) {
            *path = 0;
            return;
        }
        *end = 0;
    }
    if (strlen(path) + sizeof "/resources" <= LONGEST_PATH)
        strcat(path, "/resources");
}

unsigned char *files_read(const char *folder, const char *name, size_t *size)
{
    char path[LONGEST_PATH + 64];
    unsigned char *bytes = NULL;
    FILE *file;
    long end;
    snprintf(path, sizeof path, "%s/%.60s", folder, name);
    file = *folder ? open_file(path) : NULL;
    if (!file)
        return NULL;
    if (!fseek(file, 0, SEEK_END) && (end = ftell(file)) > 0 && end < LARGEST_FILE && !fseek(file, 0, SEEK_SET)
        && (bytes = malloc((size_t)end)) && (*size = fread(bytes, 1, (size_t)end, file)) != (size_t)end) {
        free(bytes);
        bytes = NULL;
    }
    fclose(file);
    return bytes;
}

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility pop
#endif
