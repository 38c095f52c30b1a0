"""A run as one HTML file that plays it without sero-mj and without a network.

In: a scene and a recorded or simulated run. Out: the file.
Open first: `capture.py` (frames, collected without OpenGL), then `encode.py` (bytes of a run) and
`page.py` (the HTML file). `js/` contains the player's sources, `static/` its bundle.
"""
