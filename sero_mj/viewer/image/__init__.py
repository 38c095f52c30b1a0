"""Renders images and videos without a window, and finds the item at a pixel of an image.

In: a scene, or a world and its state. Out: arrays, images and videos.
Open first: `render.py`. `backend.py` selects EGL or OSMesa, and `renderer.py` the renderer.
`image_files.py` writes files, `camera.py` and `framing.py` place the camera, and `picking.py` finds
the item at a pixel.
"""
