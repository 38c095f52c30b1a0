"""Robots and scenes in other file formats, as the tables of our own.

In: a file of another format, and mesh files. Out: `ImportedTables`: the tables that our TOML file
would have, their source lines, and what was lost.
Open first: `imported_tables.py`; then `importer.py` (what all formats have), and the format:
`urdf.py`, `mjcf_robot.py`; `robot_file.py` selects it.
"""
