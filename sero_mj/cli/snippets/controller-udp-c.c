/* A controller for sero-mj as a separate program, over UDP:
 *
 *     cc -O2 controller.c -o controller
 *     sero-mj simulate controller.toml          (sero-mj new --snippet controller-udp-c --scene prints it)
 */
#include <arpa/inet.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>

#define SERO_JOINTS 7

struct sero_state { /* little-endian, the byte order of x86 and ARM */
  uint32_t step, flags; /* step counts from 1; flags is 1 in the first step */
  double time;          /* s */
  double angles[SERO_JOINTS], velocities[SERO_JOINTS], torques[SERO_JOINTS]; /* measured; rad, rad/s, Nm */
  double target_angles[SERO_JOINTS], target_velocities[SERO_JOINTS], gravity[SERO_JOINTS];
};
struct sero_answer {
  uint32_t step, unused; /* the step of the state that this answers */
  double torques[SERO_JOINTS];
};

int main(int argc, char **argv) {
  int from = socket(AF_INET, SOCK_DGRAM, 0);
  struct sockaddr_in address = {0}, robot;
  struct sero_state state;
  struct sero_answer answer = {0};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  address.sin_port = htons(argc > 1 ? atoi(argv[1]) : 32010);
  if (bind(from, (struct sockaddr *)&address, sizeof address)) return perror("bind"), 1;
  for (;;) {
    socklen_t length = sizeof robot;
    ssize_t size = recvfrom(from, &state, sizeof state, 0, (struct sockaddr *)&robot, &length);
    if (size != sizeof state) {
      fprintf(stderr, "found %zd bytes; expected %zu\n", size, sizeof state);
      continue;
    }
    answer.step = state.step;
    for (int i = 0; i < SERO_JOINTS; i++) /* joint impedance with gravity compensation */
      answer.torques[i] = 800.0 * (state.target_angles[i] - state.angles[i]) +
                          40.0 * (state.target_velocities[i] - state.velocities[i]) + state.gravity[i];
    sendto(from, &answer, sizeof answer, 0, (struct sockaddr *)&robot, length);
  }
}
