"""Shows the packets that arrive at a UDP port, and guesses their structure.

In: packets of any sender and size. Out: `sero-mj structure --sniff PORT`.
Open first: `listen.py`; `guess.py` proposes structures, `mixed_layout.py` those of several types.
"""
