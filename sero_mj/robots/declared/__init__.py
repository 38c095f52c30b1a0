"""What is declared of robots and scenes, in files or in Python, and the checks of it.

In: TOML tables, those of importers, keyword arguments. Out: a `SerialRobot` or a `Scene`, in which
every reference and every number of entries has been checked; nothing of MuJoCo yet.
Open first: `robot_declaration.py` and `scene.py`; then `robot.py` for what follows from a robot's
fields, `scene_file.py` for reading files.
"""
