"""Controllers that are programs of users, in other languages or processes.

In: what sensors measure, at every step. Out: torques, from a library, or from a program over UDP.
Open first: `exchange.py` for what is sent and what comes back, `program.py` for the program.
"""
