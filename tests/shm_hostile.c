/* Writes torn packets on purpose: half of one, a pause, the other half.
 *
 *     hostile BLOCK MODE PAUSE_US BETWEEN_US SETTLE_US
 *
 * MODE: lock (a seqlock), first or last (a counter written before or after the rest), none.
 * On SIGTERM it prints how many packets it has written, and in how many it was held up in the
 * middle for SETTLE_US or longer, which is more than a reader without a lock can notice.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

enum { VALUES = 30 };
struct packet {
    _Atomic unsigned long long lock;
    volatile unsigned long long count;
    volatile double values[VALUES];
};

static volatile sig_atomic_t over;
static void stop(int number) { over = number; }

static double now_us(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1e6 + t.tv_nsec * 1e-3;
}

static void wait_us(double length) {
    for (double end = now_us() + length; length > 0 && now_us() < end && !over;)
        if (length > 1000) usleep(100);
}

int main(int argc, char **argv) {
    if (argc != 6) return 2;
    const char *mode = argv[2];
    const int locked = !strcmp(mode, "lock"), first = !strcmp(mode, "first");
    const double pause = atof(argv[3]), between = atof(argv[4]), settle = atof(argv[5]);
    signal(SIGTERM, stop);
    const int fd = shm_open(argv[1], O_RDWR | O_CREAT, 0600);
    if (fd < 0 || ftruncate(fd, sizeof(struct packet)) < 0) return 1;
    struct packet *p = mmap(NULL, sizeof *p, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (p == MAP_FAILED) return 1;
    unsigned long long n = p->count, held_up = 0;
    while (!over) {
        n++;
        const double start = now_us();
        if (locked) {
            const unsigned long long odd = atomic_load(&p->lock) | 1;
            atomic_store_explicit(&p->lock, odd, memory_order_relaxed);
            atomic_thread_fence(memory_order_release);
        }
        if (locked || first) p->count = n;
        for (int i = 0; i < VALUES / 2; i++) p->values[i] = n;
        wait_us(pause);
        if (over) break; /* in the middle of it */
        for (int i = VALUES / 2; i < VALUES; i++) p->values[i] = n;
        if (!locked && !first) p->count = n;
        if (locked) atomic_store_explicit(&p->lock, atomic_load(&p->lock) + 1, memory_order_release);
        held_up += now_us() - start >= settle;
        wait_us(between);
    }
    printf("%llu %llu\n", n, held_up);
    return 0;
}
