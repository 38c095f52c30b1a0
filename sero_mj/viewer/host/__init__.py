"""The common base of windows and pages.

In: a mirror and events. Out: frames, and actions on clock, switches and tools.
Open first: `live.py`; `pointer.py` handles the pointer, and `start_page.py` lists what can be
opened.
"""
