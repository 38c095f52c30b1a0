"""Suggests a declaration for DH rows without a joint, such as the first row of Kinova's tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...base.errors import Problem
from ...base.frames import Array, rpy_from_rotation
from ..kinematics.dh import COLUMNS, DhTable

FIXED = "fixed"


def fixed_row_problem(types: Sequence[object], declared: Mapping[str, Any]) -> Problem | None:
    """Returns a problem with a suggestion if the joint types contain `fixed`, and None otherwise.

    `declared` contains the fields of the robot that have been validated so far.
    """
    if FIXED not in types:
        return None
    place = types.index(FIXED)
    rows = declared.get("dh_params")
    first = next((k for k, each in enumerate(types) if each != FIXED), len(types))
    last = max((k for k, each in enumerate(types) if each != FIXED), default=-1)
    hint = "use joint_frames, which need no rows for fixed transforms"
    if place < first or place > last:
        part = slice(0, first) if place < first else slice(last + 1, None)
        key = "dh_base_frame" if place < first else "flange_frame"
        count = len(types[part])
        hint = f"remove {'this row' if count == 1 else f'these {count} rows'} and set {key}"
        if rows is not None and len(rows) == len(types) and "dh_convention" in declared:
            hint = f"{hint} = {_frame(_transform(rows[part], key, declared))}"
    return Problem(str(place), found=FIXED, expected=f"'revolute' or 'prismatic'; {hint}")


def _transform(rows: Array, key: str, declared: Mapping[str, Any]) -> Array:
    """Returns the product of the frame declared under `key` and the transform of fixed rows."""
    columns = tuple(declared.get("dh_columns", COLUMNS))
    table = DhTable.from_rows(rows, declared["dh_convention"], columns)
    T = table.frames(np.zeros(len(rows)))[-1].copy()
    T[:3, 3] *= 1e-3 if declared.get("length_unit") == "mm" else 1.0
    before = declared.get(key, np.eye(4))
    return np.asarray(before @ T if key == "dh_base_frame" else T @ before)


def _frame(T: Array) -> str:
    xyz = ", ".join(f"{x + 0.0:.6g}" for x in T[:3, 3].round(9))
    rpy = ", ".join(f"{x + 0.0:.6g}" for x in np.rad2deg(rpy_from_rotation(T[:3, :3])).round(6))
    return f"{{ xyz = [{xyz}], rpy_deg = [{rpy}] }}"
