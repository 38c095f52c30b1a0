"""Importers of robots and scenes, and readers of mesh files.

In: files of other formats. Out: `ImportedTables`, the tables of an equivalent TOML file.
Open first: `importer.py`, then the formats `urdf.py` and `mjcf_robot.py`.
"""
