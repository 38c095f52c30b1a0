"""Example code for control loops of Franka: `sero-mj new --snippet franka-cpp`."""

from __future__ import annotations

from ...cli.new import Snippet

_WITHOUT_GRAVITY = " + {robot}.gravity_torques"  # is added to the commanded torques of libfranka
CPP = Snippet(__package__, "franka-cpp.cpp", "fr3", _WITHOUT_GRAVITY)
PYTHON = Snippet(__package__, "franka-python.py", "fr3", _WITHOUT_GRAVITY)
