"""Columns of tables that `record.py` of Universal Robots' RTDE client writes."""

from __future__ import annotations

from ...simulate.runs.tables import ColumnNames

COLUMNS = ColumnNames(
    {
        "joint_angles": ("actual_q",),
        "joint_velocities": ("actual_qd",),
        "torques": ("actual_current_as_torque",),
        "commanded_torques": ("target_moment",),
        "commanded_angles": ("target_q",),
    }
)
