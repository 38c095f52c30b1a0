"""Robots: from files of any format to a compiled world, compiled once.

In: robot and scene files, in our format and others, or declarations in Python. Out: a `World` (or,
for a model compiled elsewhere, a `ModelWorld`), which all other packages read.
Open first: `assemble/world.py`; `declared/` checks robots and scenes, `importers/` reads other
formats, `external/` accepts compiled models.
"""
