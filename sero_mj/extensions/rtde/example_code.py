"""Example code for control loops of Universal Robots: `sero-mj new --snippet ur`."""

from __future__ import annotations

from ...cli.new import Snippet

PYTHON = Snippet(__package__, "ur.py", "ur5e")
