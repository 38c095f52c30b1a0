"""Motor torques in, measured angles, velocities and torques out: the robot that is simulated."""
