"""Geoms to pixels, clicks to switches.

In: a mirror, or the user's own model and data. Out: pictures and films (`headless/`), a window
(`window/`), a web page (`web/`).
Open first: `session/live.py` (what window and page share); `decor/draw.py` (what is drawn, a
function of the world's state), `session/interaction.py` (actions of clicks and keys), `camera.py`
(the view). `tools/` are what pointer and keys do to robots and time, `panels/` what both hosts show
beside the picture, `program/` is the viewer that a user's own loop steers.
"""
