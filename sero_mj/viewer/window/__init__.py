"""A window on the screen, with GLFW and MuJoCo's classic renderer.

In: a mirror. Out: frames on the screen, and the user's actions.
Open first: `host.py`. `chrome.py` builds the panels with Dear ImGui (`imgui_layer.py`).
`start_window.py` shows the start page.
"""
