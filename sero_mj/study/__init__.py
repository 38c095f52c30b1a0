"""Analysis of runs.

Input: `RunLog`s. Output: comparisons, summaries, figures, and results of parallel tasks.
Start with `compare.py`. `plot.py` and `figure.py` draw, `engine.py` runs parallel tasks.
"""
