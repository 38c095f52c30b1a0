"""Foundations shared by all wings.

In: nothing of ours. Out: errors with their data as attributes, frames, declarations checked by
pydantic, TOML files with lines and nearest names, paths of shipped files, and entry points.
Open first: `errors.py`; then `declaration.py` and `plugins.py`.
"""
