"""`MjData` to geoms, every frame: a function of world, data, toggles and view."""
