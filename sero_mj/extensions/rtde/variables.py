"""RTDE variables that the simulated robot supports, and recipes that encode their values.

Names and types are those of UR's RTDE guide, protocol version 2, for PolyScope 5.23.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from .receiver import IN_USE, NOT_FOUND, VARIABLES

REGISTERS = 48  # number of integer registers, and of double registers
INPUT_INT, INPUT_DOUBLE = "input_int_register_", "input_double_register_"
OUTPUT_INT, OUTPUT_DOUBLE = "output_int_register_", "output_double_register_"

_CODES = {
    "BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d",
    "VECTOR3D": "3d", "VECTOR6D": "6d", "VECTOR6INT32": "6i",
}  # fmt: skip


def _registers(direction: str) -> dict[str, str]:
    bits = {f"{direction}_bit_registers{k}_to_{k + 31}": "UINT32" for k in (0, 32)}
    single = {f"{direction}_bit_register_{k}": "BOOL" for k in range(64, 128)}
    ints = {f"{direction}_int_register_{k}": "INT32" for k in range(REGISTERS)}
    doubles = {f"{direction}_double_register_{k}": "DOUBLE" for k in range(REGISTERS)}
    return {**bits, **single, **ints, **doubles}


# Variables that come from the simulation, beginning with those that `RtdeReceiver` requests.
SIMULATED = {
    **{name: kind for name, kind, _ in VARIABLES},
    **dict.fromkeys(
        ("target_qd", "target_qdd", "target_current", "joint_control_output", "actual_TCP_pose",
         "actual_TCP_speed", "target_TCP_pose", "target_TCP_speed", "ft_raw_wrench"),
        "VECTOR6D",
    ),
    **dict.fromkeys(("robot_status_bits", "safety_status_bits", "runtime_state"), "UINT32"),
    **dict.fromkeys(("target_speed_fraction", "tcp_force_scalar"), "DOUBLE"),
    "actual_digital_output_bits": "UINT64",
}  # fmt: skip
# Constant variables and their values. Quantities without a meaning in simulation are 0.
CONSTANT: dict[str, tuple[str, Any]] = {
    "joint_mode": ("VECTOR6INT32", [253] * 6),  # running
    "safety_status": ("INT32", 1),  # normal
    **dict.fromkeys(("speed_scaling", "speed_scaling_combined"), ("DOUBLE", 1.0)),
    **dict.fromkeys(
        ("actual_execution_time", "actual_momentum", "actual_main_voltage", "actual_robot_voltage",
         "actual_robot_current", "standard_analog_input0", "standard_analog_input1",
         "standard_analog_output0", "standard_analog_output1", "tool_analog_input0",
         "tool_analog_input1", "tool_output_current", "tool_temperature", "payload"),
        ("DOUBLE", 0.0),
    ),
    **dict.fromkeys(
        ("joint_temperatures", "actual_joint_voltage", "payload_inertia", "tcp_offset"),
        ("VECTOR6D", [0.0] * 6),
    ),
    **dict.fromkeys(("actual_tool_accelerometer", "payload_cog"), ("VECTOR3D", [0.0] * 3)),
    **dict.fromkeys(("analog_io_types", "tool_mode", "tool_analog_input_types"), ("UINT32", 0)),
    "tool_output_voltage": ("INT32", 0),
    "actual_digital_input_bits": ("UINT64", 0),
}  # fmt: skip
INPUTS = {
    **_registers("input"),
    **dict.fromkeys(
        ("standard_digital_output_mask", "standard_digital_output",
         "configurable_digital_output_mask", "configurable_digital_output",
         "tool_digital_output_mask", "tool_digital_output", "standard_analog_output_mask",
         "standard_analog_output_type"),
        "UINT8",
    ),
    **dict.fromkeys(
        ("speed_slider_fraction", "standard_analog_output_0", "standard_analog_output_1"), "DOUBLE"
    ),
    "speed_slider_mask": "UINT32",
    "external_force_torque": "VECTOR6D",
}  # fmt: skip
# Input registers can be read back.
OUTPUTS = {
    **SIMULATED,
    **{name: kind for name, (kind, _) in CONSTANT.items()},
    **_registers("output"),
    **_registers("input"),
}


class Recipe:
    """Encodes and decodes the values of the variables that a client has requested.

    Attributes:
        size: total size of the values in bytes.
    """

    def __init__(self, names: bytes, known: Mapping[str, str], in_use: frozenset[str]) -> None:
        text = names.decode("ascii", "replace")
        self.names = [name.strip() for name in text.split(",") if name.strip()]
        self.types = [
            IN_USE if name in in_use else known.get(name, NOT_FOUND) for name in self.names
        ]
        self.is_valid = bool(self.names) and all(kind in _CODES for kind in self.types)
        codes = [_CODES.get(kind, "") for kind in self.types]
        self._struct = struct.Struct(">" + "".join(codes))
        self._counts = [int(code[:-1] or 1) for code in codes]
        self.size = self._struct.size

    def pack(self, value_of: Callable[[str], Any]) -> bytes:
        """Encodes the values that `value_of` returns, each a number or a vector of numbers."""
        numbers: list[Any] = []
        for name, count in zip(self.names, self._counts, strict=True):
            value = value_of(name)
            if count == 1:
                numbers.append(value)
            else:
                numbers.extend(value)
        return self._struct.pack(*numbers)

    def unpack(self, data: bytes) -> dict[str, Any]:
        """Returns the decoded values by name. Raises ValueError if a number is not finite."""
        numbers = self._struct.unpack(data)
        if not np.isfinite(numbers).all():
            raise ValueError("the package contains a number that is not finite")
        found: dict[str, Any] = {}
        at = 0
        for name, count in zip(self.names, self._counts, strict=True):
            found[name] = numbers[at] if count == 1 else list(numbers[at : at + count])
            at += count
        return found
