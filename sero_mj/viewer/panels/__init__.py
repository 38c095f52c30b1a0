"""The panels of windows and pages, which share one implementation.

In: a window or page, and its switches. Out: changes of the switches.
Open first: `../tools/model_view.py`, a short example of a panel. To add a panel, write a subclass
of `Tool` whose method `build(ui)` calls the methods of `session.widgets.Widgets`, and declare an
entry point in the group `sero_mj.tools`. `imgui_widgets.py` draws the widgets in windows, and
`dom_widgets.py` converts them to HTML elements of pages.
"""
