/* Writes packets of 112 bytes to shared memory at an even rate: shm_beat BLOCK RATE COUNT
 * A lock (odd while it writes), the time of writing (CLOCK_MONOTONIC, s), then 12 float64. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

struct packet {
    _Atomic unsigned long long lock;
    double sent, numbers[12];
};

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(int argc, char **argv) {
    if (argc != 4) return 2;
    const double rate = atof(argv[2]);
    const long count = atol(argv[3]);
    const int fd = shm_open(argv[1], O_RDWR | O_CREAT, 0644);
    if (fd < 0 || ftruncate(fd, sizeof(struct packet)) < 0) return perror(argv[1]), 1;
    struct packet *p = mmap(NULL, sizeof *p, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (p == MAP_FAILED) return perror(argv[1]), 1;
    const double start = now();
    for (long k = 0; k < count; k++) {
        const double due = start + k / rate;
        double left;
        while ((left = due - now()) > 0)
            if (left > 2e-4) usleep((useconds_t)((left - 1e-4) * 1e6));
        const unsigned long long odd = atomic_load_explicit(&p->lock, memory_order_relaxed) | 1;
        atomic_store_explicit(&p->lock, odd, memory_order_relaxed);
        atomic_thread_fence(memory_order_release);
        for (int i = 0; i < 12; i++) p->numbers[i] = 1e-6 * (k % 100000);
        p->sent = now();
        atomic_store_explicit(&p->lock, odd + 1, memory_order_release);
    }
    return shm_unlink(argv[1]);
}
