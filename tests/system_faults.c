/* Faults of the system, for LD_PRELOAD: calls that touch files of one folder fail, or large requests for memory do.

   FAULTS_FOLDER   the folder
   FAULTS_RECORD   a file outside of it: a line "kind file" for each call that could fail, or for those that did
   FAULT           "kind,number,errno,name": the call of this number of one process on files with such a name (any,
                   where it is empty) fails; "number+" all from it on
   FAULTS_RANK     only in this rank of MPI; empty: in any process, and once in all
   Kinds: open, create, read, write, truncate, allocate, rename, remove, mkdir, sync, lock, memory.
   Memory counts from the first file of the folder on, before which the program is loaded.
   Two kinds are limits from the start on: size, of files in bytes, and space, of addresses in MB. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

#define LARGE 4096 /* bytes, below which a request for memory never fails */

static int number, all, code, seen, armed, inside;
static char kind_wanted[16];
static const char *folder, *record, *name_wanted = "";

/* Writes by system calls of its own, so as not to hear itself. */
static int note(const char *kind, const char *name, int first) {
    char line[2 * PATH_MAX + 64];
    int file = syscall(SYS_openat, AT_FDCWD, record, O_WRONLY | O_APPEND | O_CREAT | (first ? O_EXCL : 0), 0666);
    if (file < 0) return 0;
    int length = snprintf(line, sizeof line, "%s %s\n", kind, name);
    syscall(SYS_write, file, line, length);
    syscall(SYS_close, file);
    return 1;
}

__attribute__((constructor)) static void begin(void) {
    const char *fault = getenv("FAULT"), *rank = getenv("FAULTS_RANK"), *own = getenv("OMPI_COMM_WORLD_RANK");
    char plus = 0;
    record = getenv("FAULTS_RECORD");
    if (rank && *rank && (!own || strcmp(rank, own))) return;
    if (fault && sscanf(fault, "%15[^,],%d%c", kind_wanted, &number, &plus) >= 2) {
        all = plus == '+';
        name_wanted = strrchr(fault, ',') + 1;
        code = atoi(strchr(strchr(fault, ',') + 1, ',') + 1);
    }
    folder = getenv("FAULTS_FOLDER");
    int size = !strcmp(kind_wanted, "size");
    if (size || !strcmp(kind_wanted, "space")) {
        rlim_t most = size ? number : number * 1000000L;
        struct rlimit limit = {most, most};
        note(kind_wanted, kind_wanted, 0);
        setrlimit(size ? RLIMIT_FSIZE : RLIMIT_AS, &limit);
    }
}

/* Whether this call fails. */
static int fails(const char *kind, const char *name) {
    int before = errno, hit;
    if (!*kind_wanted) {
        if (record && strcmp(kind, "memory")) note(kind, name, 0);
        if (record && !strcmp(kind, "memory") && ++seen % 100 == 0) note(kind, "100", 0);
        errno = before;
        return 0;
    }
    if (strcmp(kind, kind_wanted) || !strstr(name, name_wanted)) return 0;
    seen++;
    hit = seen == number || (all && seen > number);
    if (hit && seen == number && record && !note(kind, name, 1)) { /* another process had it */
        number = 0;
        hit = all = 0;
    } else if (hit && seen > number && record) {
        note(kind, name, 0);
    }
    errno = hit ? code : before;
    return hit;
}

static int in_folder(const char *name) {
    size_t length = strlen(folder);
    return !strncmp(name, folder, length) && (name[length] == '/' || !name[length]);
}

static int named(const char *kind, const char *name) {
    char whole[2 * PATH_MAX], here[PATH_MAX];
    int result;
    if (!folder || inside || !name) return 0;
    inside = 1;
    if (name[0] == '/') snprintf(whole, sizeof whole, "%s", name);
    else if (getcwd(here, sizeof here)) snprintf(whole, sizeof whole, "%s/%s", here, name);
    else whole[0] = 0;
    result = 0;
    if (in_folder(whole)) {
        armed = 1;
        result = fails(kind, whole);
    }
    inside = 0;
    return result;
}

static int numbered(const char *kind, int file) {
    char link[64], name[PATH_MAX];
    int before = errno, result = 0;
    if (!folder || inside) return 0;
    inside = 1;
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = syscall(SYS_readlinkat, AT_FDCWD, link, name, sizeof name - 1);
    errno = before;
    if (length > 0) {
        name[length] = 0;
        if (in_folder(name)) result = fails(kind, name);
    }
    inside = 0;
    return result;
}

static int memory(size_t size) {
    int result = 0;
    if (!folder || !armed || inside || size < LARGE) return 0;
    inside = 1;
    result = fails("memory", "memory");
    inside = 0;
    return result;
}

#define REAL(name) static __typeof__(&name) real; if (!real) real = dlsym(RTLD_NEXT, #name)
#define OPENS(flags) ((flags) & (O_CREAT | O_WRONLY | O_RDWR) ? "create" : "open")
#define OPEN(name) int name(const char *path, int flags, ...) { \
    va_list more; va_start(more, flags); mode_t mode = va_arg(more, mode_t); va_end(more); REAL(name); \
    return named(OPENS(flags), path) ? -1 : real(path, flags, mode); }
#define OPENAT(name) int name(int at, const char *path, int flags, ...) { \
    va_list more; va_start(more, flags); mode_t mode = va_arg(more, mode_t); va_end(more); REAL(name); \
    return (at == AT_FDCWD || *path == '/') && named(OPENS(flags), path) ? -1 : real(at, path, flags, mode); }
#define FOPEN(name) FILE *name(const char *path, const char *mode) { REAL(name); \
    return named(*mode == 'r' ? "open" : "create", path) ? NULL : real(path, mode); }
#define ON_PATH(kind, name, bad, result, types, ...) result name types { REAL(name); \
    return named(kind, path) ? bad : real(__VA_ARGS__); }
#define ON_FILE(kind, name, bad, result, types, ...) result name types { REAL(name); \
    return numbered(kind, file) ? bad : real(__VA_ARGS__); }

OPEN(open) OPEN(open64) OPENAT(openat) OPENAT(openat64) FOPEN(fopen) FOPEN(fopen64)
ON_PATH("truncate", truncate, -1, int, (const char *path, off_t size), path, size)
ON_PATH("rename", rename, -1, int, (const char *path, const char *to), path, to)
ON_PATH("rename", renameat, -1, int, (int at, const char *path, int at_to, const char *to), at, path, at_to, to)
ON_PATH("remove", unlink, -1, int, (const char *path), path)
ON_PATH("remove", unlinkat, -1, int, (int at, const char *path, int flags), at, path, flags)
ON_PATH("remove", rmdir, -1, int, (const char *path), path)
ON_PATH("mkdir", mkdir, -1, int, (const char *path, mode_t mode), path, mode)
ON_FILE("read", read, -1, ssize_t, (int file, void *to, size_t size), file, to, size)
ON_FILE("read", pread, -1, ssize_t, (int file, void *to, size_t size, off_t at), file, to, size, at)
ON_FILE("read", pread64, -1, ssize_t, (int file, void *to, size_t size, off64_t at), file, to, size, at)
ON_FILE("write", write, -1, ssize_t, (int file, const void *from, size_t size), file, from, size)
ON_FILE("write", pwrite, -1, ssize_t, (int file, const void *from, size_t size, off_t at), file, from, size, at)
ON_FILE("write", pwrite64, -1, ssize_t, (int file, const void *from, size_t size, off64_t at), file, from, size, at)
ON_FILE("write", writev, -1, ssize_t, (int file, const struct iovec *from, int count), file, from, count)
ON_FILE("truncate", ftruncate, -1, int, (int file, off_t size), file, size)
ON_FILE("truncate", ftruncate64, -1, int, (int file, off64_t size), file, size)
ON_FILE("allocate", fallocate, -1, int, (int file, int mode, off_t at, off_t size), file, mode, at, size)
ON_FILE("allocate", posix_fallocate, errno, int, (int file, off_t at, off_t size), file, at, size)
ON_FILE("allocate", posix_fallocate64, errno, int, (int file, off64_t at, off64_t size), file, at, size)
ON_FILE("sync", fsync, -1, int, (int file), file)
ON_FILE("lock", flock, -1, int, (int file, int kind), file, kind)

void *mmap(void *at, size_t size, int protect, int flags, int file, off_t from) {
    REAL(mmap);
    return file >= 0 && numbered("open", file) ? MAP_FAILED : real(at, size, protect, flags, file, from);
}

extern void *__libc_malloc(size_t), *__libc_calloc(size_t, size_t), *__libc_realloc(void *, size_t);
void *malloc(size_t size) { return memory(size) ? NULL : __libc_malloc(size); }
void *calloc(size_t count, size_t size) { return memory(count * size) ? NULL : __libc_calloc(count, size); }
void *realloc(void *old, size_t size) { return memory(size) ? NULL : __libc_realloc(old, size); }
