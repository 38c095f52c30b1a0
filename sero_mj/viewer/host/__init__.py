"""The common base of windows and pages.

In: a mirror and input events. Out: frames, and actions on the clock, the switches and the tools.
Open first: `live.py`. `pointer.py` handles the mouse pointer. `start_page.py` lists the scenes,
robots and recordings that the user can open.
"""
