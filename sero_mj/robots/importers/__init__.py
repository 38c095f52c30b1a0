"""Robots and scenes in other file formats, as the tables of our own.

In: a file of another format, and mesh files. Out: `ImportedTables`: the tables that our TOML file
would have, their source lines, and what was lost.
Open first: `imported_tables.py`; then `robot_file.py`, which selects the importer, and `x3d.py` for
scenes.
"""
