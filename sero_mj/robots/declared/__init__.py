"""Declarations of robots and scenes, in files or in Python, and their validation.

In: tables from TOML files, importers, or keyword arguments. Out: a `SerialRobot` or a `Scene` whose
references and numbers of entries are valid. This package does not use MuJoCo.
Open first: `robot_declaration.py` and `scene.py`; then `robot.py` for derived quantities of robots,
and `scene_file.py` for reading files.
"""
