"""A window on the screen: GLFW and MuJoCo's classic renderer.

In: a world that is shown, and its clock. Out: frames on the screen; clicks and keys.
Open first: `host.py`; `chrome.py` places what the panels declare beside the picture and over it,
by Dear ImGui (`imgui_layer.py`); `start_window.py` is the start page.
"""
