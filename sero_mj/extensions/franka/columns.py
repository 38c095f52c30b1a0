"""Column names of tables that libfranka writes (`franka::logToCSV`)."""

from __future__ import annotations

from ...simulate.runs.tables import ColumnNames

# `tau_J_d` does not include gravity and is therefore not the commanded torque. External torques
# are torques that the robot exerts on its environment (sources: docs/conventions.md).
COLUMNS = ColumnNames(
    {
        "torques": ("tau_j",),
        "commanded_angles": ("q_d",),
        "external_torques": ("tau_ext_hat_filtered",),
    },
    opposite=("tau_ext_hat_filtered",),
    prefixes=("state.",),  # in tables since 2024
)
