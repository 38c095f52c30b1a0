/* Plays the controller of an LWR on FRI 1.0: fri_master PORT RATE COUNT
 * Sends measurements of 916 bytes at an even rate and takes the answers as they come.
 * Prints how many it sent, the shares in % that were answered and answered within 2 ms, and the
 * latencies p50, p99 and the longest (us). An answer has come when the kernel has it: this program
 * may have to wait for a core, which a controller does not. */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum { SIZE = 916, STATE = 144, FLANGE = 244, COMMANDED = 348 };

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_REALTIME, &t); /* as the kernel's time stamps */
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

static int rising(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double sent[1 << 16], *latencies;
static long answered, within;

static void take(int sock) {
    uint16_t head[256];
    char control[64];
    struct iovec part = {.iov_base = head, .iov_len = sizeof head};
    struct msghdr message = {.msg_iov = &part, .msg_iovlen = 1, .msg_control = control};
    for (;;) {
        message.msg_controllen = sizeof control;
        if (recvmsg(sock, &message, MSG_DONTWAIT) <= 4) return;
        const double at = sent[head[1]];
        const struct cmsghdr *stamp = CMSG_FIRSTHDR(&message);
        if (!at || !stamp) continue;
        struct timespec t;
        memcpy(&t, CMSG_DATA(stamp), sizeof t);
        sent[head[1]] = 0; /* counts once */
        const double latency = t.tv_sec + 1e-9 * t.tv_nsec - at;
        latencies[answered++] = latency;
        if (latency <= 2e-3) within++;
    }
}

int main(int argc, char **argv) {
    if (argc != 4) return 2;
    const double rate = atof(argv[2]);
    const long count = atol(argv[3]);
    struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons((unsigned short)atoi(argv[1]))};
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    const int sock = socket(AF_INET, SOCK_DGRAM, 0), on = 1;
    setsockopt(sock, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on);
    unsigned char packet[SIZE] = {0};
    uint16_t head[4] = {0, 0, SIZE, 0x2006}, good[2] = {1, 3};
    const float upright[12] = {1, 0, 0, 0.1f, 0, 1, 0, 0.2f, 0, 0, 1, 0.3f};
    memcpy(packet + STATE, good, sizeof good);
    memcpy(packet + FLANGE, upright, sizeof upright);
    memcpy(packet + COMMANDED, upright, sizeof upright);
    latencies = calloc((size_t)count + 1, sizeof *latencies);
    const double start = now();
    for (long k = 0; k < count; k++) {
        const double due = start + k / rate;
        double left;
        while ((left = due - now()) > 0) {
            struct pollfd ready = {.fd = sock, .events = POLLIN};
            const long ns = left > 1e-4 ? (long)((left - 5e-5) * 1e9) : 0;
            struct timespec most = {.tv_sec = ns / 1000000000, .tv_nsec = ns % 1000000000};
            if (ppoll(&ready, 1, &most, NULL) > 0) take(sock);
        }
        const float stamp = (float)(k / rate);
        head[0] = (uint16_t)k;
        memcpy(packet, head, sizeof head);
        memcpy(packet + 140, &stamp, sizeof stamp);
        sent[head[0]] = now();
        sendto(sock, packet, SIZE, 0, (struct sockaddr *)&to, sizeof to);
    }
    for (int k = 0; k < 50; k++) { /* what is still on its way */
        take(sock);
        usleep(2000);
    }
    qsort(latencies, (size_t)answered, sizeof *latencies, rising);
    printf("%ld %.3f %.3f", count, 100.0 * answered / count, 100.0 * within / count);
    const long n = answered ? answered : 1;
    printf(" %.0f %.0f %.0f\n", 1e6 * latencies[n / 2], 1e6 * latencies[(n * 99) / 100],
           1e6 * latencies[n - 1]);
    return 0;
}
