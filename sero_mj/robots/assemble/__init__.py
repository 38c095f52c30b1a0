"""Compile robot and scene files into a world, once.

In: robot files, scene files, or the same declared in Python. Out: a `World`: the `MjModel`, ids by
name, and slots of `MjData.userdata` for values that MuJoCo has no field for.
Open first: `world.py`; then `robot_declaration.py` and `scene.py` for what files may declare,
`robot.py` for what follows from it, `mjcf.py` for building the model, `dh.py` for the kinematics
that check it.
"""
