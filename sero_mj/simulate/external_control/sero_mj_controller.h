/* A controller of sero-mj as a shared library: kind = "library".
 *
 *     cc -O2 -shared -fPIC controller.c -o controller.so
 *
 * `control` is called once in every step of the simulation. It reads the state, and writes `torques_out`.
 * All arrays have n numbers, of joints from the base to the flange: rad and Nm of revolute joints, m and N of
 * prismatic ones. They are the same arrays in every step.
 */
#ifndef SERO_MJ_CONTROLLER_H
#define SERO_MJ_CONTROLLER_H

#ifdef __cplusplus
extern "C" {
#endif

struct sero_mj_robot {
  int n;                              /* number of joints */
  int is_first;                       /* 1 in the first step of a run */
  double time;                        /* s since the start */
  double timestep;                    /* s between two steps */
  const double *angles;               /* what the sensors measure */
  const double *velocities;
  const double *torques;
  const double *target_angles;        /* what is asked for */
  const double *target_velocities;
  const double *target_accelerations;
  const double *gravity;              /* torques that hold the robot; NULL with gravity = false */
  double *torques_out;                /* to be written; holds those of the last step */
};

void control(struct sero_mj_robot *robot);

#ifdef __cplusplus
}
#endif
#endif
