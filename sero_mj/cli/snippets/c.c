/* Call sero_send in your control loop. It does not block or allocate memory, and ignores errors. */
#include <arpa/inet.h>
#include <stdint.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>

#define SERO_JOINTS 7
#define SERO_HOST "127.0.0.1" /* the computer that runs sero-mj */
#define SERO_PORT 32000

#pragma pack(push, 1)
struct sero_packet {
  uint32_t count; /* all values are little-endian, the byte order of x86 and ARM */
  double time, angles[SERO_JOINTS]; /* s, rad */
  double torques[SERO_JOINTS], commanded[SERO_JOINTS]; /* Nm */
};
#pragma pack(pop)

static inline void sero_send(const double *angles, const double *torques, const double *commanded) {
  static int socket_ = -1;
  static struct sockaddr_in to;
  static struct sero_packet packet;
  struct timespec now;
  if (socket_ < 0) {
    socket_ = socket(AF_INET, SOCK_DGRAM, 0);
    to.sin_family = AF_INET;
    to.sin_port = htons(SERO_PORT);
    inet_pton(AF_INET, SERO_HOST, &to.sin_addr);
  }
#ifdef TIME_UTC /* C11 */
  timespec_get(&now, TIME_UTC);
#else
  clock_gettime(CLOCK_REALTIME, &now);
#endif
  packet.count++;
  packet.time = now.tv_sec + 1e-9 * now.tv_nsec;
  memcpy(packet.angles, angles, sizeof packet.angles);
  memcpy(packet.torques, torques, sizeof packet.torques);
  memcpy(packet.commanded, commanded, sizeof packet.commanded);
  sendto(socket_, &packet, sizeof packet, MSG_DONTWAIT, (struct sockaddr *)&to, sizeof to);
}
