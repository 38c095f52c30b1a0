"""Draws arrows, axes and billboards over photos, videos and live camera images of real robots.

In: a photo, a video or a camera, and a camera file or clicked points. Out: the pose of the camera
in the world, and images and videos with arrows, axes and billboards.
Open first: `photo_camera.py`. `calibration.py` computes the pose, and `over_photo.py` draws.
"""
