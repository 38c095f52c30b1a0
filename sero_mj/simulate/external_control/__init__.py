"""Controllers in other languages or processes.

In: sensor readings in every step. Out: torques from a library, or from a program over UDP or shared
memory.
Open first: `exchange.py` (packets), `program_controller.py` (the controller), `program.py` (the
process).
"""
