"""Tools that need no simulation: jogging, undo, recording, images and plots.

In: a window or page, and its events. Out: poses of robots, recordings and images.
Open first: `jogging.py` (robots without data), `model_view.py` (a short panel) and
`../session/tool.py` (the base class). All tools are entry points in the group `sero_mj.tools`.
"""
