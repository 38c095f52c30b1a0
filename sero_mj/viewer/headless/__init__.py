"""Pictures and films without a window: `mujoco.Renderer` on EGL or OSMesa.

In: a scene, or a world and its state. Out: arrays, pictures and films.
Open first: `render.py`; `backend.py` chooses EGL or OSMesa, `film.py` writes files.
"""
