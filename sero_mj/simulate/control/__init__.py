"""Controllers and target motions.

Controllers compute torques from a robot's declaration, measured joint states and a target motion.
Open first: `controller.py`; then `joint_control.py`, and `robot_model.py` for the model of the
robot that controllers use.
"""
