"""The panels of windows and pages, written once for both.

In: a window or page, and its switches. Out: changes of these.
Open first: `../tools/model_view.py`, a short panel of its own. To add a panel, write such a tool: a
subclass of `Tool` whose method `build(ui)` calls the methods of `session.widgets.Widgets`, with an
entry point in the group `sero_mj.tools`. Windows draw the widgets with `imgui_widgets.py`, and
`dom_widgets.py` turns them into HTML elements of pages.
"""
