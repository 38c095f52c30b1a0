"""Panels of windows and pages, written once for both.

In: a host's world, toggles, and what its user sets by hand. Out: changes of these.
Open first: `robot_panel.py`. Panels are made of `session.widgets`; `imgui_widgets.py` draws them in
windows with Dear ImGui, `dom_widgets.py` makes the tree that pages show as HTML elements.
"""
