"""Files to `MjModel`, once: robots, scenes, and the world compiled from them."""
