"""Draws decor over photos, videos and live camera images of real robots.

In: a photo, a video or a camera, and the camera's file or clicked points. Out: the camera's pose in
the world, and videos synchronized with a recording.
Open first: `photo_camera.py`. `calibration.py` computes the pose, `over_photo.py` draws.
"""
