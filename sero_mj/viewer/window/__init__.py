"""A window on the screen: GLFW and MuJoCo's classic renderer.

In: a world that is shown, and its clock. Out: frames on the screen; clicks and keys.
Open first: `host.py`; `hud.py` is what stands beside the picture, `panel_layer.py` the panel
over it; `start_window.py` is the start page.
"""
