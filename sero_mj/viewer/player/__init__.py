"""A run as one file: an HTML page that plays it, or a glTF animation.

In: a scene, and what happened in it. Out: a file that needs neither sero-mj nor a network.
Open first: `capture.py` (frames, collected without OpenGL); then `encode.py` (bytes of a run),
`page.py` (the HTML file) and `gltf.py`. `js/` has the player's sources, `static/` its bundle.
"""
