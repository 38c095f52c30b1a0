"""Controllers in other languages or processes.

In every step, a library, or a program over UDP or shared memory, receives sensor readings and
returns torques.
Open first: `exchange.py` (packets), `program_controller.py` (the controller), `program.py` (the
process).
"""
