"""Trends of a robot's parameters over many recordings.

In: recordings of the same motion, and a baseline. Out: `sero-mj compare NIGHTS --baseline GOOD`.
Open first: `compare_trends.py`. `measured.py` reads the parameters of a recording, `trend.py`
describes their changes, which `change_points.py` finds, and `trend_page.py` draws them.
"""
