"""What all wings stand on.

In: nothing of ours. Out: errors that keep what they are about, frames, declarations checked by
pydantic, TOML files with lines and nearest names, where shipped files are, and entry points.
Open first: `errors.py`; then `declaration.py` and `plugins.py`.
"""
