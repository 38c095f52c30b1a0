"""Exports runs as HTML files, which browsers play without sero-mj and without a network.

In: a scene and a recorded or simulated run. Out: the file.
Open first: `capture.py` (frames, collected without OpenGL), then `encode.py` (bytes of a run) and
`page.py` (the HTML file). `js/` contains the player's sources, and `static/` its bundle.
"""
