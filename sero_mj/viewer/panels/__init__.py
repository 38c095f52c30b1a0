"""Panels of live hosts: what windows and pages show beside the picture, written once for both.

In: a host's world, toggles, and what its user sets by hand. Out: changes of these.
Open first: `widgets.py`, what panels are made of; windows bind it to imgui-bundle
(`window/bundle_widgets.py`), pages to MuJoCo Studio's imgui (`web/studio_widgets.py`).
"""
