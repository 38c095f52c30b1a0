"""Analysis of runs.

In: `RunLog`s. Out: comparisons, summaries, figures, sweeps over many variants.
Open first: `compare.py`; `plot.py` and `figure.py` draw, `sweep.py` runs variants and
`sweep_results.py` stores their results.
"""
