// Preloaded into the program (LD_PRELOAD) by tests/all/faults: the calls that change files under one folder are
// counted, and one of them fails as on a full or broken disk.
//
//   FAULT_FOLDER   the folder, absolute
//   FAULT_AT       number of the call that fails, counted from 1; 0 for none
//   FAULT_ERROR    its errno
//   FAULT_COUNT    a file outside the folder that takes the number of calls at the end
//
// A write that fails has written its first half, since disks do that too.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

static atomic_long calls;

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

static int is_below(const char* path) {
  const char* folder = getenv("FAULT_FOLDER");
  return folder && path && strncmp(path, folder, strlen(folder)) == 0;
}

// Puts the path of an open file into `path`.
static int is_open_below(int file, char path[PATH_MAX]) {
  char link[64];
  snprintf(link, sizeof link, "/proc/self/fd/%d", file);
  const ssize_t length = readlink(link, path, PATH_MAX - 1);
  if (length <= 0) return 0;
  path[length] = 0;
  return is_below(path);
}

// Counts a call; sets errno, says so on standard error and gives 1 where it must fail.
static int fails(const char* call, const char* path) {
  const char *at = getenv("FAULT_AT"), *error = getenv("FAULT_ERROR");
  const long number = atomic_fetch_add(&calls, 1) + 1;
  if (!at || number != atol(at)) return 0;
  fprintf(stderr, "fault: %s %s\n", call, path);
  errno = error ? atoi(error) : EIO;
  return 1;
}

__attribute__((destructor)) static void report(void) {
  const char* path = getenv("FAULT_COUNT");
  if (!path) return;
  FILE* out = fopen(path, "w");
  if (!out) return;
  fprintf(out, "%ld\n", (long)calls);
  fclose(out);
}

// Whether a call that opens has a file or is to make one: what is not there cannot fail to be read.
static int has_file(const char* path, int flags) { return (flags & O_CREAT) != 0 || access(path, F_OK) == 0; }

#define OPEN(name)                                                                \
  int name(const char* path, int flags, ...) {                                    \
    va_list rest;                                                                 \
    va_start(rest, flags);                                                        \
    const mode_t mode = va_arg(rest, mode_t);                                     \
    va_end(rest);                                                                 \
    if (is_below(path) && has_file(path, flags) && fails(#name, path)) return -1; \
    return NEXT(name)(path, flags, mode);                                         \
  }
OPEN(open)
OPEN(open64)

#define OPENAT(name)                                                              \
  int name(int folder, const char* path, int flags, ...) {                        \
    va_list rest;                                                                 \
    va_start(rest, flags);                                                        \
    const mode_t mode = va_arg(rest, mode_t);                                     \
    va_end(rest);                                                                 \
    if (is_below(path) && has_file(path, flags) && fails(#name, path)) return -1; \
    return NEXT(name)(folder, path, flags, mode);                                 \
  }
OPENAT(openat)
OPENAT(openat64)

ssize_t write(int file, const void* bytes, size_t count) {
  char path[PATH_MAX];
  if (is_open_below(file, path) && fails("write", path)) {
    const int error = errno;
    if (NEXT(write)(file, bytes, count / 2) < 0) return -1;
    errno = error;
    return -1;
  }
  return NEXT(write)(file, bytes, count);
}

ssize_t writev(int file, const struct iovec* parts, int count) {
  char path[PATH_MAX];
  if (is_open_below(file, path) && fails("writev", path)) return -1;
  return NEXT(writev)(file, parts, count);
}

#define ON_FILE(name)                                               \
  int name(int file) {                                              \
    char path[PATH_MAX];                                            \
    if (is_open_below(file, path) && fails(#name, path)) return -1; \
    return NEXT(name)(file);                                        \
  }
ON_FILE(fsync)
ON_FILE(fdatasync)

#define TRUNCATE(name, type)                                        \
  int name(int file, type length) {                                 \
    char path[PATH_MAX];                                            \
    if (is_open_below(file, path) && fails(#name, path)) return -1; \
    return NEXT(name)(file, length);                                \
  }
TRUNCATE(ftruncate, off_t)
TRUNCATE(ftruncate64, off64_t)

int rename(const char* from, const char* to) {
  if (is_below(to) && fails("rename to", to)) return -1;
  return NEXT(rename)(from, to);
}

int renameat2(int from_folder, const char* from, int to_folder, const char* to, unsigned flags) {
  if (is_below(to) && fails("rename to", to)) return -1;
  return NEXT(renameat2)(from_folder, from, to_folder, to, flags);
}

int linkat(int from_folder, const char* from, int to_folder, const char* to, int flags) {
  if (is_below(to) && fails("linkat", to)) return -1;
  return NEXT(linkat)(from_folder, from, to_folder, to, flags);
}

int symlink(const char* target, const char* path) {
  if (is_below(path) && fails("symlink", path)) return -1;
  return NEXT(symlink)(target, path);
}

int mkdir(const char* path, mode_t mode) {
  if (is_below(path) && fails("mkdir", path)) return -1;
  return NEXT(mkdir)(path, mode);
}
