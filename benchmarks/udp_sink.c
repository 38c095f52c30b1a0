/* Counts packets with recvmmsg, the least that any receiver can do: udp_sink SECONDS
 * Prints its port, then, after SECONDS without a packet once some came, how many came. */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>

enum { BATCH = 256, SIZE = 113 };

int main(int argc, char **argv) {
    static char data[BATCH][SIZE];
    static struct iovec vectors[BATCH];
    static struct mmsghdr headers[BATCH];
    if (argc != 2) return 2;
    const int sock = socket(AF_INET, SOCK_DGRAM, 0), buffer = 4 << 20;
    struct sockaddr_in here = {.sin_family = AF_INET};
    here.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (bind(sock, (struct sockaddr *)&here, sizeof here)) return 1;
    setsockopt(sock, SOL_SOCKET, SO_RCVBUF, &buffer, sizeof buffer);
    socklen_t length = sizeof here;
    getsockname(sock, (struct sockaddr *)&here, &length);
    printf("%d\n", ntohs(here.sin_port));
    fflush(stdout);
    for (int i = 0; i < BATCH; i++) {
        vectors[i] = (struct iovec){data[i], SIZE};
        headers[i].msg_hdr = (struct msghdr){.msg_iov = &vectors[i], .msg_iovlen = 1};
    }
    long count = 0;
    int got = recvmmsg(sock, headers, BATCH, MSG_WAITFORONE, NULL);
    const struct timeval quiet = {.tv_sec = atoi(argv[1])};
    setsockopt(sock, SOL_SOCKET, SO_RCVTIMEO, &quiet, sizeof quiet);
    while (got > 0) {
        count += got;
        got = recvmmsg(sock, headers, BATCH, MSG_WAITFORONE, NULL);
    }
    printf("%ld\n", count);
    return 0;
}
