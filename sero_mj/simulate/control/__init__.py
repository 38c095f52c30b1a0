"""What a controller knows and does.

In: a robot's declaration, measured joint states, and a target motion. Out: commanded torques.
Open first: `make_controller.py` (the kinds; a new one is entered there), then `joint_control.py`
and `cartesian_control.py`; `robot_model.py` is what a controller knows of its robot.
`target_motions.py` and `way_points.py` are the target motions, of which `plan.py` makes targets,
those of the flange by `inverse_kinematics.py`.
"""
