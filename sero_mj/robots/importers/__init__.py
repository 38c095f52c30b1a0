"""Imports robots and scenes from files of other formats, and reads mesh files.

The input is a file of another format. The output, `ImportedTables`, contains the tables of an
equivalent TOML file. Start with `importer.py`, and continue with `urdf.py` and `mjcf_robot.py`.
"""
