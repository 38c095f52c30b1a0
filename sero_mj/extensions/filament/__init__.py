"""MuJoCo's Filament renderer, headless: soft shadows, occlusion and physical materials on Vulkan.

In: the scene of the classic renderer, whose geoms become objects of Filament. Out: pixels.
Open first: `renderer.py`. `probe.py` checks whether Filament works on this machine.
"""
