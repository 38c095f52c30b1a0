"""Scenes with routes to all inputs whose values are computed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sero_mj.data.drive.wiring import wire
from sero_mj.robots.declared.cartesian import SmartArrow
from sero_mj.robots.declared.double import Double
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene

TWO = {
    "udp": {"kind": "udp", "structure": "2F2F3F2M"},
    "other": {"kind": "udp", "structure": "2F1V"},
}


def arm(name: str, types: list[str] | None = None, **fields: Any) -> SerialRobot:
    rows = [[0.0, 0.0, 0.0, 0.3], [1.5, 0.2, 0.0, 0.0]]
    return SerialRobot(
        name=name, dh_convention="craig", dh_params=rows, joint_types=types, **fields
    )


def scene_of(routes: Mapping[str, Any], **fields: Any) -> Scene:
    robots = [arm("lwr"), arm("leader", joint_angles=[0.3, -0.4]), arm("crane", ["prismatic"] * 2)]
    robots.append(arm("mixed", ["revolute", "prismatic"]))
    declared: dict[str, Any] = {
        "robots": robots,
        "sources": TWO,
        "doubles": [Double(name="goal", of="lwr")],
        "arrows": [SmartArrow(name="push", kind="force", at="lwr/flange")],
        "floor": False,
    }
    return Scene(**{**declared, **fields}, routes=dict(routes))


def messages(routes: Mapping[str, Any], **fields: Any) -> list[str]:
    return [problem.message for problem in wire(scene_of(routes, **fields)).problems]
