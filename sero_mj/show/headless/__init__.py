"""Pictures and films without a window: `mujoco.Renderer` on EGL or OSMesa."""
