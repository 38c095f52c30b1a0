"""Render geoms to pixels, and apply clicks and keys to toggles.

In: a mirror, or the user's own model and data. Out: pictures and films (`headless/`), a window
(`window/`), a web page (`web/`); panels of both (`panels/`), and what else they share beside.
Open first: `viewer.py` (a live viewer in Python, drawn by the process of `viewer_main.py`),
`live.py` (what window and page share), `interaction.py` (actions of clicks and keys),
`picking.py` (finds the item at a pixel); `jogging.py`, `pulling.py` and `steering.py` are what the
pointer drags: robots without data, simulated ones, and their targets; `over_photo.py` draws over
photos, `photo_camera.py` is their camera, `calibration.py` finds it; `start_page.py` lists what can
be opened, `recent_views.py` what was viewed lately.
"""
