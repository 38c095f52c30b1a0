/* A controller for sero-mj as a shared library:
 *
 *     cc -O2 -shared -fPIC controller.c -o controller.so
 *     sero-mj simulate controller.toml          (printed by sero-mj new --snippet controller-c --scene)
 */
#include "sero_mj_controller.h"

/* Joint impedance: a spring and a damper at the target, and gravity compensation. */
void control(struct sero_mj_robot *robot) {
  const double stiffness = 800.0, damping = 40.0; /* Nm/rad, Nm s/rad */
  for (int i = 0; i < robot->n; i++)
    robot->torques_out[i] = stiffness * (robot->target_angles[i] - robot->angles[i]) +
                            damping * (robot->target_velocities[i] - robot->velocities[i]) +
                            robot->gravity[i];
}
