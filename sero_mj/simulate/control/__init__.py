"""What a controller knows and does.

In: a robot's declaration, measured joint states, and a target motion. Out: commanded torques.
Open first: `controller.py` (what every kind has), then `joint_control.py` and
`cartesian_control.py`; `robot_model.py` is what a controller knows of its robot.
`target_motions.py` and `way_points.py` are the target motions, of which `plan.py` makes targets.
Kinds of both are entry points.
"""
