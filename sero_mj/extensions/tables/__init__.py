"""Tables of numbers, such as CSV files, as recordings.

In: text files with a time column, and columns of joint signals or of numbers in packets. Out: the
source kind `table`, and tables in `view --replay`, `compare`, `plot`, `send` and scenarios.
Open first: `kind.py`; `table.py` reads cells, `signals.py` recognizes columns.
"""
