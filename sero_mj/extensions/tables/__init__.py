"""Tables of numbers, such as CSV files, as recordings.

In: text files with columns of times and of joint signals or numbers of packets. Out: the source
kind `table`, and tables in `view --replay`, `compare`, `plot`, `send` and targets of scenarios.
Open first: `kind.py`; `table.py` reads cells, `signals.py` recognizes columns.
"""
