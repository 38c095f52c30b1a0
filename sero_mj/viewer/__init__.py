"""Rendering and user interfaces: images, videos, windows and web pages of robots.

In: a mirror, or the user's own model and data. Out: images and videos (`image/`), a window
(`window/`), a web page (`web/`).
Open first: `decor/draw.py` (what is drawn), `image/render.py` (images without a window),
`image/clicks.py` (actions of clicks and keys), `host/live.py` (what windows and pages share).
"""
