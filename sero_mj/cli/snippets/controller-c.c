/* A controller for sero-mj as a shared library:
 *
 *     cc -O2 -shared -fPIC controller.c -o controller.so
 *     sero-mj simulate controller.toml          (sero-mj new --snippet controller-c --scene prints it)
 */
#include "sero_mj_controller.h"

/* Joint impedance: stiffness and damping about the target, plus gravity compensation. */
void control(struct sero_mj_robot *robot) {
  const double stiffness = 800.0, damping = 40.0; /* Nm/rad, Nm s/rad */
  for (int i = 0; i < robot->n; i++)
    robot->torques_out[i] = stiffness * (robot->target_angles[i] - robot->angles[i]) +
                            damping * (robot->target_velocities[i] - robot->velocities[i]) +
                            robot->gravity[i];
}
