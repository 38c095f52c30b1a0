"""The page of a viewer in a notebook cell.

In: a viewer. Out: the viewer's page in a cell, and the last minute as a run in the notebook file.
Open first: `cells.py`.
"""
