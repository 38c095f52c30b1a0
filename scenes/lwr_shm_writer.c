/* Writes joint angles and torques of an LWR to shared memory at 1 kHz, for lwr_shm.toml.
 *
 *     cc -O2 -o writer lwr_shm_writer.c -lrt -lm  &&  ./writer [block [seconds]]
 */
#define _POSIX_C_SOURCE 200809L
#include <fcntl.h>
#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

struct packet { /* structure = "lock:1Q angles:7d torques:7d" */
    _Atomic unsigned long long lock; /* odd during a write; readers then wait */
    double angles[7];                /* rad */
    double torques[7];               /* Nm */
};

int main(int argc, char **argv) {
    const char *block = argc > 1 ? argv[1] : "/sero_lwr";
    const double seconds = argc > 2 ? atof(argv[2]) : 3600.0;
    const int fd = shm_open(block, O_RDWR | O_CREAT, 0644);
    if (fd < 0 || ftruncate(fd, sizeof(struct packet)) < 0) return perror(block), 1;
    struct packet *p = mmap(NULL, sizeof *p, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (p == MAP_FAILED) return perror(block), 1;

    struct timespec next;
    clock_gettime(CLOCK_MONOTONIC, &next);
    for (long k = 0; k < seconds * 1000; k++) {
        const double t = k * 1e-3;
        /* | 1: the lock is already odd if a previous writer ended during a write. */
        const unsigned long long odd = atomic_load_explicit(&p->lock, memory_order_relaxed) | 1;
        atomic_store_explicit(&p->lock, odd, memory_order_relaxed);
        atomic_thread_fence(memory_order_release); /* the lock becomes odd before the data changes */
        for (int j = 0; j < 7; j++) {
            p->angles[j] = 0.6 * sin(t + j);
            p->torques[j] = 20.0 * cos(t + j);
        }
        atomic_store_explicit(&p->lock, odd + 1, memory_order_release); /* even: the packet is complete */
        if ((next.tv_nsec += 1000000) >= 1000000000) next.tv_nsec -= 1000000000, next.tv_sec++;
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, NULL);
    }
    return shm_unlink(block);
}
