"""`evidence_at`: the residuals of a joint before and after an explanation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...base.frames import Array, Bools
from ...study.evidence import Evidence, Side, count_left_out
from ...study.explanation import Explanation, Kind, Part
from .torque_residuals import TorqueResiduals

SIDES: tuple[Side, Side] = ("link", "drive")


def evidence_at(
    found: TorqueResiduals,
    joint: int,
    side: int,
    before: Array,
    after: Array,
    kind: Kind,
    part: Part,
) -> Evidence:
    """Returns the evidence of an explanation at a joint.

    Args:
        found: the residuals of the robot.
        joint: index of the joint.
        side: 0 for the link side, 1 for the drive side.
        before: residuals without all other explanations, shape (K,); NaN for rows not used.
        after: residuals without all explanations, shape (K,).
        kind: kind of the fault.
        part: faulty part.
    """
    quantity = _quantity(kind, part)
    unit, values = _values(found, joint, quantity)
    reasons = {reason: rows[side, :, joint] for reason, rows in found.left_out.items()}
    return Evidence(
        found.robot.names[joint], SIDES[side], found.times, before, after, quantity, unit, values,
        torque_unit(found, joint), count_left_out(~np.isfinite(before), reasons),
    )  # fmt: skip


def with_log_evidence(
    faults: Sequence[Explanation], recorded: TorqueResiduals, correct: TorqueResiduals
) -> list[Explanation]:
    """Returns faults of the log with the residuals of the recorded and of the correct signals."""
    names, found = recorded.robot.names, []
    for fault in faults:
        before = np.stack([recorded.link, recorded.motor])
        others = [k for k, name in enumerate(names) if name not in fault.joints]
        before[:, :, others] = np.nan
        side, joint = worst_joint(before, recorded.scale)
        after = (correct.motor if side else correct.link)[:, joint]
        evidence = evidence_at(
            recorded, joint, side, before[side, :, joint], after, fault.kind, fault.part
        )
        found.append(replace(fault, evidence=evidence))
    return found


def torque_unit(found: TorqueResiduals, joint: int) -> str:
    """Returns the unit of the torques of a joint."""
    return "Nm" if _is_revolute(found, joint) else "N"


def _quantity(kind: Kind, part: Part) -> str:
    # Name of the quantity on which the effect of a fault depends.
    if part == "angles":
        return "angle"
    is_driven = part in ("drive", "commands", "commanded torques")
    torque = "commanded torque" if is_driven else "model torque"
    of_kind: dict[Kind, str] = {
        "noise": "time",
        "friction": "velocity",
        "friction drift": "velocity",
        "stuck": "velocity" if part == "joint" else torque,
        "motor inertia": "acceleration",
        "delay": f"rate of the {torque}",
        "clock": f"rate of the {torque}",
        "load friction": "model torque",
        "elasticity": "model torque",
        "backlash": "model torque",
        "masses": "model torque",
        "sign": torque,
        "gain": torque,
        "saturation": torque,
        "scale": torque,
    }
    return of_kind.get(kind, "angle")


def _values(found: TorqueResiduals, joint: int, quantity: str) -> tuple[str, Array]:
    # Unit and values (K,) of a quantity.
    motion, torques = found.motion, found.torques
    factor, angle = (180.0 / np.pi, "deg") if _is_revolute(found, joint) else (1.0, "m")
    torque = torque_unit(found, joint)
    if quantity == "time":
        return "s", found.times
    if quantity.endswith("torque"):
        values = torques.commanded if "commanded" in quantity else torques.model
        is_rate = quantity.startswith("rate")
        values = np.gradient(values, found.step, axis=0) if is_rate else values
        return f"{torque}/s" if is_rate else torque, values[:, joint]
    unit, values = {
        "angle": (angle, motion.links[0]),
        "velocity": (f"{angle}/s", motion.velocities),
        "acceleration": (f"{angle}/s²", motion.accelerations),
    }[quantity]
    return unit, factor * values[:, joint]


def _is_revolute(found: TorqueResiduals, joint: int) -> bool:
    return found.robot.types[joint] == "revolute"


def rows_line(found: TorqueResiduals) -> str:
    """Returns a line with the shares of rows that were used, and why others were left out."""
    texts = []
    for side, residuals in enumerate((found.link, found.motor)):
        unknown: Bools = ~np.isfinite(residuals)
        if side == 1 and not np.isfinite(found.torques.commanded).any():
            continue  # not recorded
        reasons = {reason: rows[side] for reason, rows in found.left_out.items()}
        counts = count_left_out(unknown, reasons)
        shares = [f"{reason} {_percent(count, unknown.size)}" for reason, count in counts.items()]
        used = _percent(unknown.size - sum(counts.values()), unknown.size)
        text = f"{used} on the {SIDES[side]} side"
        texts.append(f"{text} (left out: {', '.join(shares)})" if shares else text)
    return f"rows used: {'; '.join(texts)}" if texts else ""


def _percent(count: int, of: int) -> str:
    share = 100.0 * count / of
    return f"{share:.0f} %" if share >= 1.0 or not count else "under 1 %"


def worst_joint(torques: Array, scale: Array) -> tuple[int, int]:
    """Returns side and joint of the largest torques, shape (2, K, n), relative to a scale (n,)."""
    rms = np.sqrt(np.mean(np.nan_to_num(torques) ** 2, axis=1)) / scale
    side, joint = np.unravel_index(int(np.argmax(rms)), rms.shape)
    return int(side), int(joint)


def merged(first: TorqueResiduals, second: TorqueResiduals) -> dict[str, Bools]:
    """Returns the reasons why rows of either of two runs were left out."""
    return {reason: rows | second.left_out[reason] for reason, rows in first.left_out.items()}
