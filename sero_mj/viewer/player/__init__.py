"""A run as one file: an HTML page that plays it, or a glTF animation.

In: a scene, and what happened in it. Out: a file that needs neither sero-mj nor a network.
Open first: `capture.py` (what a run is for the page, collected without OpenGL); then `encode.py`
(its bytes), `page.py` (the HTML file), `gltf.py`. `js/` has the player's sources, in JavaScript;
`static/` what they are bundled to.
"""
