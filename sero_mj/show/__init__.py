"""Geoms to pixels, and clicks to toggles.

In: a mirror, or the user's own model and data. Out: pictures and films (`headless/`), a window
(`window/`), a web page (`web/`); what they share stands beside these folders.
Open first: `viewer.py` (a live viewer in Python), `interaction.py` (what a click or a key does),
`picking.py` (what is at a pixel).
"""
