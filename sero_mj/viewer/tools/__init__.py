"""Tools that need no simulation: jogging, undo, recording, images and plots.

In: a window or page, and its input events. Out: poses of robots, recordings and images.
Open first: `../session/tool.py` (the base class), `model_view.py` (a short example) and
`jogging.py` (moves robots without data). Tools are entry points in the group `sero_mj.tools`.
"""
