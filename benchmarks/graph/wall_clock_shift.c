/* Preloaded into a process, this shifts its wall clock by the nanoseconds in the file $WALL_CLOCK_SHIFT.
   Deadlines on the wall clock are given to the system in its own time. Waits that have begun are not lengthened. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
#define SECOND 1000000000LL
#define WALL 1000000000LL /* later than this is no time since boot [s] */
static volatile long long zero, *shift = &zero;
__attribute__((constructor)) static void begin(void) {
    const char *path = getenv("WALL_CLOCK_SHIFT");
    int file = path ? open(path, O_RDONLY) : -1;
    void *page = file < 0 ? MAP_FAILED : mmap(0, sizeof zero, PROT_READ, MAP_SHARED, file, 0);
    if (page != MAP_FAILED) shift = page;
}
static struct timespec moved(const struct timespec *t, long long by) {
    long long all = t->tv_sec * SECOND + t->tv_nsec + by;
    return (struct timespec){all / SECOND, all % SECOND};
}
int clock_gettime(clockid_t clock, struct timespec *t) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "clock_gettime");
    int result = real(clock, t);
    if (!result && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) *t = moved(t, *shift);
    return result;
}
time_t time(time_t *out) {
    struct timespec t;
    clock_gettime(CLOCK_REALTIME, &t);
    if (out) *out = t.tv_sec;
    return t.tv_sec;
}
int gettimeofday(struct timeval *restrict out, void *restrict zone) {
    struct timespec t;
    clock_gettime(CLOCK_REALTIME, &t);
    (void)zone;
    *out = (struct timeval){t.tv_sec, t.tv_nsec / 1000};
    return 0;
}
int pthread_cond_clockwait(pthread_cond_t *c, pthread_mutex_t *m, clockid_t clock, const struct timespec *t) {
    static int (*real)(pthread_cond_t *, pthread_mutex_t *, clockid_t, const struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "pthread_cond_clockwait");
    struct timespec end = moved(t, clock == CLOCK_REALTIME ? -*shift : 0);
    return real(c, m, clock, &end);
}
int pthread_cond_timedwait(pthread_cond_t *c, pthread_mutex_t *m, const struct timespec *t) {
    static int (*real)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
    if (!real) real = dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2"); /* x86-64 has an older one as well */
    if (!real) real = dlsym(RTLD_NEXT, "pthread_cond_timedwait");
    struct timespec end = moved(t, t->tv_sec > WALL ? -*shift : 0); /* the condition alone knows its clock */
    return real(c, m, &end);
}
int sem_timedwait(sem_t *restrict s, const struct timespec *restrict t) {
    struct timespec end = moved(t, -*shift);
    return sem_clockwait(s, CLOCK_REALTIME, &end);
}
int pthread_mutex_timedlock(pthread_mutex_t *restrict m, const struct timespec *restrict t) {
    struct timespec end = moved(t, -*shift);
    return pthread_mutex_clocklock(m, CLOCK_REALTIME, &end);
}
