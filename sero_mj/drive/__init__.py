"""Values to `MjData`, every tick: routes, kinematics, motions."""
