"""`MjData` to geoms, every frame: a function of world, data, toggles and view.

In: a world, its data, what is switched on, and from where one looks. Out: geoms and labels in a
`Pen`, which hosts copy into their `mjvScene`.
Open first: `draw.py`; each feature has a file, `quantities.py` is where their numbers come from.
"""
