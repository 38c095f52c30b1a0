"""Files in which others describe robots and scenes, as the tables of our own.

In: a file of another format, and mesh files. Out: `ImportedTables`: the tables that a TOML file of
ours would have, the lines they come from, and what was lost.
Open first: `imported_tables.py`; then `robot_file.py`, which says what reads which ending, and
`x3d.py` for scenes.
"""
