"""The page of a viewer in a notebook cell.

In: a viewer that a cell displays. Out: its page in the cell, and the last minute as a stored run.
Open first: `cells.py`.
"""
