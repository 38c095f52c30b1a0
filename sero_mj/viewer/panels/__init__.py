"""Panels of live hosts: what windows and pages show beside the picture, written once for both.

In: a host's world, toggles, and what its user sets by hand. Out: changes of these.
Open first: `widgets.py`, what panels are made of. `imgui_widgets.py` makes it of Dear ImGui and
ImPlot: windows bind it to imgui-bundle, pages to MuJoCo Studio's (`web/studio_widgets.py`), and say
where the panels are (`window/chrome.py`, `web/page_windows.py`).
"""
