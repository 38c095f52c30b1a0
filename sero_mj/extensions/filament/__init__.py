"""Renders images with soft shadows, occlusion and materials, with the Filament renderer of MuJoCo.

In: an `MjvScene`, whose geoms become objects of Filament. Out: pixels.
Open first: `renderer.py`. `probe.py` checks whether Filament works on this machine.
"""
