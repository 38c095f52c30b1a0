"""Imports robots and scenes from files of other formats, and reads mesh files.

In: a file of another format. Out: `ImportedTables`, the tables of an equivalent TOML file.
Open first: `importer.py`, then the formats `urdf.py` and `mjcf_robot.py`.
"""
