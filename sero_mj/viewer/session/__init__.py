"""The state of a window or page, and the base classes of tools and panels.

In: a mirror and input events. Out: the displayed time, histories, keys and settings.
Open first: `tool.py` (the base class of tools), `widgets.py` (the widgets of panels), `clock.py`.
"""
