"""Example code for control loops of Franka robots (`sero-mj new --snippet franka-cpp`)."""

from __future__ import annotations

from ...cli.new import Snippet

_WITHOUT_GRAVITY = " + {robot}.gravity_torques"  # added to torques commanded through libfranka
CPP = Snippet(__package__, "franka-cpp.cpp", "fr3", _WITHOUT_GRAVITY)
PYTHON = Snippet(__package__, "franka-python.py", "fr3", _WITHOUT_GRAVITY)
