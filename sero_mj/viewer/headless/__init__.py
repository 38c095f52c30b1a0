"""Pictures and films without a window: `mujoco.Renderer` on EGL or OSMesa, or Filament on Vulkan.

In: a scene, or a world and its state. Out: arrays, pictures and films.
Open first: `render.py`; `backend.py` chooses EGL or OSMesa, `renderer_choice.py` Filament where
it runs, `film.py` writes files.
"""
