"""Analysis of runs.

In: `RunLog`s. Out: comparisons, summaries, figures; many tasks at once.
Open first: `compare.py`; `plot.py` and `figure.py` draw, `engine.py` does many tasks.
"""
