"""Renders with MuJoCo's Filament renderer: soft shadows, occlusion and materials on Vulkan.

In: the scene of the classic renderer, whose geoms become objects of Filament. Out: pixels.
Open first: `renderer.py`. `probe.py` checks whether Filament works on this machine.
"""
