// Loaded before libc: counts the calls that change files, and kills the process just before one of them. A write that is hit
// has written half of its bytes.
//
// KILLER_AT=N    the call before which the process is killed, counted from 1
// KILLER_LOG=F   a line for each call is appended to F
// KILLER_BEFORE=NAME  the process is killed before a file whose path ends in NAME is renamed so
// KILLER_NO_LINKS=1   no file gets a second name: the file system says that it is another one
// KILLER_FULL=NAME    the disk is full for files whose path ends in NAME
//
// Programs of others, which genesplat starts, are left alone.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

static long calls;

static int is_ours(void) {
    const char *name = program_invocation_short_name;
    return strcmp(name, "genesplat") == 0 || strcmp(name, "genesplat-lab") == 0;
}

static int is_hit(const char *name, const char *path) {
    if (!is_ours()) return 0;
    const char *log = getenv("KILLER_LOG"), *at = getenv("KILLER_AT");
    long call = __atomic_add_fetch(&calls, 1, __ATOMIC_SEQ_CST);
    if (log) {
        int file = syscall(SYS_openat, AT_FDCWD, log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
        dprintf(file, "%s %s\n", name, path);
        syscall(SYS_close, file);
    }
    return at && call == atol(at);
}

static void die(void) {
    kill(getpid(), SIGKILL);
    for (;;) pause();
}

static int ends_in(const char *path, const char *name) {
    return name && strlen(path) >= strlen(name) && strcmp(path + strlen(path) - strlen(name), name) == 0;
}

static void before(const char *name, const char *path) {
    if (is_hit(name, path)) die();
}

int rename(const char *from, const char *to) {
    before("rename", to);
    if (is_ours() && ends_in(to, getenv("KILLER_BEFORE"))) die();
    return REAL(rename)(from, to);
}

int unlink(const char *path) { before("unlink", path); return REAL(unlink)(path); }
int unlinkat(int folder, const char *path, int flags) { before("unlinkat", path); return REAL(unlinkat)(folder, path, flags); }
int rmdir(const char *path) { before("rmdir", path); return REAL(rmdir)(path); }
int mkdir(const char *path, mode_t mode) { before("mkdir", path); return REAL(mkdir)(path, mode); }
static int makes_no_link(void) {
    if (!getenv("KILLER_NO_LINKS")) return 0;
    errno = EXDEV;
    return 1;
}

int link(const char *from, const char *to) { before("link", to); return makes_no_link() ? -1 : REAL(link)(from, to); }
int linkat(int a, const char *from, int b, const char *to, int flags) {
    before("linkat", to);
    return makes_no_link() ? -1 : REAL(linkat)(a, from, b, to, flags);
}
int symlink(const char *from, const char *to) { before("symlink", to); return REAL(symlink)(from, to); }
int fsync(int file) { before("fsync", ""); return REAL(fsync)(file); }
int fdatasync(int file) { before("fdatasync", ""); return REAL(fdatasync)(file); }
int ftruncate64(int file, off64_t length) { before("ftruncate", ""); return REAL(ftruncate64)(file, length); }

int open64(const char *path, int flags, ...) {
    va_list rest;
    va_start(rest, flags);
    mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(rest, mode_t) : 0;
    va_end(rest);
    // Reading changes nothing.
    if (flags & (O_WRONLY | O_RDWR | O_CREAT)) before("open", path);
    return REAL(open64)(path, flags, mode);
}

static int is_full(int file) {
    const char *name = getenv("KILLER_FULL");
    char link[64], path[4096];
    if (!name || !is_ours()) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    if (!ends_in(path, name)) return 0;
    errno = ENOSPC;
    return 1;
}

// How photos are copied.
ssize_t copy_file_range(int from, off64_t *from_at, int to, off64_t *to_at, size_t length, unsigned flags) {
    if (is_hit("copy_file_range", "")) {
        struct stat whole;
        fstat(from, &whole);
        REAL(copy_file_range)(from, from_at, to, to_at, whole.st_size / 2, flags);
        die();
    }
    return REAL(copy_file_range)(from, from_at, to, to_at, length, flags);
}

ssize_t write(int file, const void *bytes, size_t length) {
    struct stat there;
    if (is_full(file)) return -1;
    if (fstat(file, &there) == 0 && S_ISREG(there.st_mode) && is_hit("write", "")) {
        REAL(write)(file, bytes, length / 2);
        die();
    }
    return REAL(write)(file, bytes, length);
}
