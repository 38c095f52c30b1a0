"""Lay out geoms and labels every frame, as a function of world, data, toggles and view.

In: a world, its data, toggles, and a view. Out: geoms and labels in a `GeomBuffer`,
which hosts copy into their `MjvScene`.
Open first: `draw.py`; each feature has a file, `quantities.py` computes the values
they show, `cards.py` places the panels beside the robots, by `layout.py`.
"""
