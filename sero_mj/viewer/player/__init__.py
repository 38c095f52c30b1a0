"""A run as one file: an HTML page that plays it.

In: a scene and a recorded or simulated run. Out: a file that needs neither sero-mj nor a network.
Open first: `capture.py` (frames, collected without OpenGL); then `encode.py` (bytes of a run) and
`page.py` (the HTML file). `js/` has the player's sources, `static/` its bundle.
"""
