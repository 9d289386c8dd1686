/* Loaded into a service under test (LD_PRELOAD) to set its clock and fill its disk.
 *
 * The file FORELIGHT_SHIM holds two 64-bit integers that a test may write at any time: seconds to add to the
 * time of day, and whether writing to files fails with ENOSPC.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

static volatile const int64_t *control;

__attribute__((constructor)) static void open_control(void) {
    const char *name = getenv("FORELIGHT_SHIM");
    int file = name ? open(name, O_RDONLY | O_CLOEXEC) : -1;
    if (file < 0) return;
    void *page = mmap(NULL, 16, PROT_READ, MAP_SHARED, file, 0);
    if (page != MAP_FAILED) control = page;
    close(file);
}

int clock_gettime(clockid_t clock, struct timespec *time) {
    int result = (int)syscall(SYS_clock_gettime, clock, time);
    if (result == 0 && clock == CLOCK_REALTIME && control) time->tv_sec += control[0];
    return result;
}

/* Standard streams still work, for the logs of failing tests. */
static int is_full(int file) {
    struct stat status;
    return control && control[1] && file > 2 && fstat(file, &status) == 0 && S_ISREG(status.st_mode);
}

#define OR_FULL(call) (is_full(file) ? (errno = ENOSPC, -1) : (call))

ssize_t write(int file, const void *bytes, size_t count) {
    return OR_FULL(syscall(SYS_write, file, bytes, count));
}

ssize_t pwrite(int file, const void *bytes, size_t count, off_t at) {
    return OR_FULL(syscall(SYS_pwrite64, file, bytes, count, at));
}

ssize_t pwrite64(int file, const void *bytes, size_t count, off64_t at) {
    return OR_FULL(syscall(SYS_pwrite64, file, bytes, count, at));
}
