"""Displays the page of a viewer in a notebook cell.

In: a viewer. Out: the viewer's page in a cell, and a run of the last minute in the notebook file.
Open first: `cells.py`.
"""
