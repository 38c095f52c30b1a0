"""Photos, videos and cameras of real robots, over which decor is drawn.

In: a picture or a stream of them, and the camera's file or clicked points. Out: the camera's pose
in the world, and footage synchronized with a recording.
Open first: `photo_camera.py`; `calibration.py` finds it, `over_photo.py` draws.
"""
