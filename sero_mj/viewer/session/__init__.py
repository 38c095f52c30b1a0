"""State of a view, and what tools and panels are made of.

In: a mirror, events, and recent views. Out: time, histories, keys and settings of the view.
Open first: `tool.py` (the base class of tools), `widgets.py` (what panels are made of), `clock.py`.
"""
