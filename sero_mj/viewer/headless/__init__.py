"""Pictures and films without a window: `mujoco.Renderer` on EGL or OSMesa, or another renderer.

In: a scene, or a world and its state. Out: arrays, pictures and films.
Open first: `render.py`; `backend.py` chooses EGL or OSMesa, `renderer.py` the
renderer, `film.py` writes files.
"""
