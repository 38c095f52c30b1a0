"""The state of a view, and the base classes of tools and panels.

In: a mirror and events. Out: time, histories, keys and settings of the view.
Open first: `tool.py` (the base class of tools), `widgets.py` (the widgets of panels), `clock.py`.
"""
