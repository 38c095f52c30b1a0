"""What every host shares while a scene is shown.

In: a mirror, events, and what was viewed before. Out: what is shown next: time, switches, view,
messages, the start page.
Open first: `live.py`; `viewer.py` is a live viewer in Python, drawn by the process of
`viewer_main.py`; `picking.py` finds the item at a pixel.
"""
