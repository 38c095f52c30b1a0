/* Sends packets of 14 float64 at an even rate: udp_flood PORT RATE COUNT
 * The first number counts, the second is the time of sending (CLOCK_MONOTONIC, s).
 * Prints what it sent, the rate it reached, and how late packets were (p50, p99, us). */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(int argc, char **argv) {
    if (argc != 4) return 2;
    const double rate = atof(argv[2]);
    const long count = atol(argv[3]);
    struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons((unsigned short)atoi(argv[1]))};
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    const int sock = socket(AF_INET, SOCK_DGRAM, 0);
    double packet[14] = {0};
    for (int i = 2; i < 14; i++) packet[i] = 0.1 * i;
    const double start = now();
    long refused = 0;
    for (long k = 0; k < count; k++) {
        const double due = start + k / rate;
        double left;
        while ((left = due - now()) > 0)
            if (left > 2e-4) usleep((useconds_t)((left - 1e-4) * 1e6));
        packet[0] = (double)k;
        packet[1] = now();
        if (sendto(sock, packet, sizeof packet, 0, (struct sockaddr *)&to, sizeof to) < 0) refused++;
    }
    printf("%ld %.0f %ld\n", count, count / (now() - start), refused);
    return 0;
}
