/* Preloaded: writes to files below FAIL_UNDER fail with the number FAIL_ERRNO after FAIL_AFTER bytes.
   A new FAIL_TURN counts anew. Without FAIL_UNDER everything is written. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/uio.h>
#include <unistd.h>

static long written;
static char turn[32];

static int fails(int descriptor, size_t size)
{
    const char *under = getenv("FAIL_UNDER"), *now = getenv("FAIL_TURN");
    char link[64], path[4096];
    if (!under || !now)
        return 0;
    if (strcmp(now, turn)) {
        snprintf(turn, sizeof turn, "%s", now);
        written = 0;
    }
    snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length <= 0)
        return 0;
    path[length] = 0;
    if (strncmp(path, under, strlen(under)))
        return 0;
    written += size;
    if (written <= atol(getenv("FAIL_AFTER")))
        return 0;
    errno = atoi(getenv("FAIL_ERRNO"));
    return 1;
}

ssize_t write(int descriptor, const void *data, size_t size)
{
    static ssize_t (*real)(int, const void *, size_t);
    if (!real)
        real = dlsym(RTLD_NEXT, "write");
    return fails(descriptor, size) ? -1 : real(descriptor, data, size);
}

ssize_t pwrite64(int descriptor, const void *data, size_t size, off64_t offset)
{
    static ssize_t (*real)(int, const void *, size_t, off64_t);
    if (!real)
        real = dlsym(RTLD_NEXT, "pwrite64");
    return fails(descriptor, size) ? -1 : real(descriptor, data, size, offset);
}

ssize_t writev(int descriptor, const struct iovec *parts, int count)
{
    static ssize_t (*real)(int, const struct iovec *, int);
    size_t size = 0;
    if (!real)
        real = dlsym(RTLD_NEXT, "writev");
    for (int i = 0; i < count; i++)
        size += parts[i].iov_len;
    return fails(descriptor, size) ? -1 : real(descriptor, parts, count);
}
