"""Lays out the arrows, axes, billboards and other visual features of each frame.

In: a world, its data, its toggles and a view. Out: a `GeomBuffer` with geoms and labels, which
windows, pages and image renderers copy into their `MjvScene`.
Open first: `draw.py`. Each feature has its own file. `quantities.py` computes the displayed
values, and `billboard_layout.py` places the billboards with the functions of `layout.py`.
"""
