"""Columns of tables that libfranka writes (`franka::logToCSV`)."""

from __future__ import annotations

from ...simulate.runs.tables import ColumnNames

# `tau_J_d` is without gravity, and therefore not the commanded torque. External torques are those
# that the robot exerts; docs/conventions.md has the sources.
COLUMNS = ColumnNames(
    {
        "torques": ("tau_j",),
        "commanded_angles": ("q_d",),
        "external_torques": ("tau_ext_hat_filtered",),
    },
    opposite=("tau_ext_hat_filtered",),
    prefixes=("state.",),  # since 2024
)
