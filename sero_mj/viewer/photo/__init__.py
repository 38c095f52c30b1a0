"""Photos, videos and cameras of real robots, over which decor is drawn.

In: a picture or a stream of them, and the camera's file or points that are clicked on. Out: the
camera in the world, and footage in time with a recording.
Open first: `photo_camera.py`; `calibration.py` finds it, `over_photo.py` draws.
"""
