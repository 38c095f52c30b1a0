"""Declarations of robots and scenes, in files or in Python, and their validation.

In: tables from TOML files, importers, or keyword arguments. Out: a `SerialRobot` or a `Scene` with
valid references and array lengths. This package does not use MuJoCo.
Open first: `robot_declaration.py` and `scene.py`. `robot.py` derives quantities of robots, and
`scene_file.py` reads files.
"""
