"""Lays out the geoms and text of each frame, as a function of world, data, toggles and view.

In: a world, its data, its toggles, and a view. Out: geoms and labels in a `GeomBuffer`, which
windows, pages and image renderers copy into their `MjvScene`.
Open first: `draw.py`. Each feature has a file. `quantities.py` computes the displayed values, and
`billboard_layout.py` places the billboards with the functions of `layout.py`.
"""
