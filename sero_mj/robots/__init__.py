"""Reads robots and scenes from files in any supported format, and compiles them into a world.

In: robot and scene files in any supported format, or declarations in Python. Out: a `World`, or a
`ModelWorld` for a model that was compiled elsewhere. All other packages read it.
Open first: `assemble/world.py`. `declared/` validates robots and scenes, `importers/` reads other
formats, and `external/` accepts compiled models.
"""
