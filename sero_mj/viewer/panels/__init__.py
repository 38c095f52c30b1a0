"""Panels of live hosts: what windows and pages show beside the picture, written once for both.

In: a host's world, toggles, and what its user sets by hand. Out: changes of these.
Open first: `widgets.py`, what panels are made of. `imgui_widgets.py` draws it in windows by Dear
ImGui, `dom_widgets.py` makes a tree of it that pages show by HTML elements; hosts say where panels
are (`window/chrome.py`, `web/page_panels.py`).
"""
