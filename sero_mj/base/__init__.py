"""Foundations of all other packages.

In: nothing from other packages. Out: errors that store their data as attributes, frames,
declarations validated by pydantic, TOML files with line numbers, paths of included files, and entry
points.
Open first: `errors.py`; then `declaration.py` and `plugins.py`.
"""
