"""The parts shared by all hosts while a scene is shown.

In: a mirror, events, and recent views. Out: the state of the display: time, switches, view,
messages, the start page.
Open first: `live.py`; `picking.py` finds the item at a pixel.
"""
