// Call sero.send(state) in your control callback. It never blocks, allocates or throws.
#include <arpa/inet.h>
#include <franka/robot_state.h>
#include <sys/socket.h>

#include <array>
#include <chrono>
#include <cstdint>

constexpr int JOINTS = 7;
constexpr const char* HOST = "127.0.0.1";  // machine that runs sero-mj
constexpr std::uint16_t PORT = 32000;

class SeroMj {
 public:
  SeroMj() : socket_(socket(AF_INET, SOCK_DGRAM, 0)) {
    to_.sin_family = AF_INET;
    to_.sin_port = htons(PORT);
    inet_pton(AF_INET, HOST, &to_.sin_addr);
  }

  void send(const franka::RobotState& state) {
    const auto now = std::chrono::system_clock::now().time_since_epoch();
    packet_.count++;
    packet_.time = std::chrono::duration<double>(now).count();
    packet_.angles = state.q;
    packet_.torques = state.tau_J;
    packet_.commanded = state.tau_J_d;
    sendto(socket_, &packet_, sizeof packet_, MSG_DONTWAIT,
           reinterpret_cast<const sockaddr*>(&to_), sizeof to_);
  }

 private:
#pragma pack(push, 1)
  struct Packet {
    std::uint32_t count = 0;
    double time = 0;
    std::array<double, JOINTS> angles{}, torques{}, commanded{};  // rad, Nm, Nm
  };
#pragma pack(pop)
  int socket_;
  sockaddr_in to_{};
  Packet packet_;
};

static SeroMj sero;

// robot.control([&](const franka::RobotState& state, franka::Duration) -> franka::Torques {
//   sero.send(state);
//   ...
// });
