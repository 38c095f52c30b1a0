"""What a robot is: from files of any format to a compiled world, once.

In: robot and scene files, ours and those of others, or declarations in Python. Out: a `World` (or,
of a model compiled elsewhere, a `ModelWorld`), which all other wings read.
Open first: `assemble/world.py`; `importers/` reads formats of others, `external/` takes models.
"""
