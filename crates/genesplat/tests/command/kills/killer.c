// Loaded before libc: counts the calls that change files, and kills the process just before one of them. A write that is hit
// has written half of its bytes.
//
// KILLER_AT=N    the call before which the process is killed, counted from 1
// KILLER_LOG=F   a line for each call is appended to F
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

static long calls;

static int is_hit(const char *name, const char *path) {
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

static void before(const char *name, const char *path) {
    if (is_hit(name, path)) die();
}

int rename(const char *from, const char *to) { before("rename", to); return REAL(rename)(from, to); }
int unlink(const char *path) { before("unlink", path); return REAL(unlink)(path); }
int unlinkat(int folder, const char *path, int flags) { before("unlinkat", path); return REAL(unlinkat)(folder, path, flags); }
int rmdir(const char *path) { before("rmdir", path); return REAL(rmdir)(path); }
int mkdir(const char *path, mode_t mode) { before("mkdir", path); return REAL(mkdir)(path, mode); }
int link(const char *from, const char *to) { before("link", to); return REAL(link)(from, to); }
int linkat(int a, const char *from, int b, const char *to, int flags) { before("linkat", to); return REAL(linkat)(a, from, b, to, flags); }
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

ssize_t write(int file, const void *bytes, size_t length) {
    struct stat there;
    if (fstat(file, &there) == 0 && S_ISREG(there.st_mode) && is_hit("write", "")) {
        REAL(write)(file, bytes, length / 2);
        die();
    }
    return REAL(write)(file, bytes, length);
}
