// A controller for sero-mj as a shared library:
//
//     c++ -O2 -std=c++17 -shared -fPIC controller.cpp -o controller.so
//     sero-mj simulate controller.toml          (sero-mj new --snippet controller-cpp --scene prints it)
#include "sero_mj_controller.h"

namespace {

// Joint impedance with a filtered velocity, which is kept between steps.
class Impedance {
 public:
  void control(sero_mj_robot &robot) {
    if (robot.is_first) filtered_[0] = 0.0;
    for (int i = 0; i < robot.n && i < kMaxJoints; i++) {
      if (robot.is_first) filtered_[i] = robot.velocities[i];
      filtered_[i] += kShare * (robot.velocities[i] - filtered_[i]);
      robot.torques_out[i] = kStiffness * (robot.target_angles[i] - robot.angles[i]) +
                             kDamping * (robot.target_velocities[i] - filtered_[i]) + robot.gravity[i];
    }
  }

 private:
  static constexpr int kMaxJoints = 64;
  static constexpr double kStiffness = 800.0, kDamping = 40.0;  // Nm/rad, Nm s/rad
  static constexpr double kShare = 0.5;                         // weight of a new velocity
  double filtered_[kMaxJoints] = {};
};

Impedance impedance;

}  // namespace

extern "C" void control(sero_mj_robot *robot) { impedance.control(*robot); }
