"""Analysis of runs.

In: `RunLog`s. Out: comparisons, summaries, figures, and results of parallel tasks.
Open first: `compare.py`. `plot.py` and `figure.py` draw, `engine.py` runs parallel tasks.
"""
