"""A humanoid with 62 joints: two legs, a torso, a neck, and two arms with five-fingered hands."""

from __future__ import annotations

from typing import Any

import numpy as np

from sero_mj.base.frames import frame, rotation_from_rpy
from sero_mj.robots.declared.robot import SerialRobot

_AXES = {"x": [0, np.pi / 2, 0], "y": [-np.pi / 2, 0, 0], "z": [0, 0, 0]}
_LEG = [("hip_yaw", "z", 0.0), ("hip_roll", "x", 0.0), ("hip_pitch", "y", 0.0),
        ("knee", "y", 0.42), ("ankle_pitch", "y", 0.42), ("ankle_roll", "x", 0.0)]  # fmt: skip
_ARM = [("shoulder_pitch", "y", 0.0), ("shoulder_roll", "x", 0.04), ("shoulder_yaw", "z", 0.12),
        ("elbow", "y", 0.18), ("wrist_yaw", "z", 0.14), ("wrist_pitch", "y", 0.13),
        ("wrist_roll", "x", 0.0)]  # fmt: skip
_FINGERS = ("thumb", "index", "middle", "ring", "little")
_EFFORT = {"hip": 200.0, "knee": 200.0, "ankle": 100.0, "torso": 150.0, "shoulder": 60.0,
           "elbow": 40.0, "wrist": 15.0, "neck": 20.0}  # fmt: skip


_RADII = {"hip": 0.05, "knee": 0.045, "ankle": 0.045, "torso": 0.06, "shoulder": 0.04,
          "elbow": 0.035, "wrist": 0.03, "neck": 0.04}  # fmt: skip


def _capsule(end: np.ndarray, radius: float) -> dict[str, Any]:
    """Returns a capsule from a link's origin to the origin of the next link."""
    length = float(np.linalg.norm(end))
    z = end / length
    x = np.cross([0.3, 1.0, 0.2], z)
    x /= np.linalg.norm(x)
    turn = np.stack([x, np.cross(z, x), z], axis=1)
    return {"shape": "capsule", "size": [radius, length], "color": "grey",
            "frame": frame(turn, end / 2)}  # fmt: skip


def humanoid(name: str = "human", *, fingers: bool = True, **fields: Any) -> SerialRobot:
    """Returns the humanoid, with 32 joints if `fingers` is false. Its base is the pelvis."""
    names: list[str] = []
    parents: list[str] = []
    frames: list[np.ndarray] = []
    turned: dict[str, np.ndarray] = {"base": np.eye(3)}  # rotation of every link at zero

    def add(joint: str, on: str, axis: str, at: list[float]) -> str:
        rotation = rotation_from_rpy(_AXES[axis])
        names.append(joint)
        parents.append(on)
        frames.append(frame(turned[on].T @ rotation, turned[on].T @ np.array(at, float)))
        turned[joint] = rotation
        return joint

    for side, sign in (("l", 1.0), ("r", -1.0)):
        on, at = "base", [0.0, 0.1 * sign, -0.08]
        for joint, axis, down in _LEG:
            on = add(f"{side}_{joint}", on, axis, [0, 0, -down] if on != "base" else at)
    on, at = "base", [0.0, 0.0, 0.1]
    for joint, axis in (("pitch", "y"), ("roll", "x"), ("yaw", "z")):
        on = add(f"torso_{joint}", on, axis, at if on == "base" else [0, 0, 0.04])
    chest = on
    for side, sign in (("l", 1.0), ("r", -1.0)):
        on = chest
        for joint, axis, down in _ARM:
            at = [0, 0.18 * sign, 0.3] if on == chest else [0, 0, -down]
            on = add(f"{side}_{joint}", on, axis, at)
        palm = on
        for k, finger in enumerate(_FINGERS if fingers else ()):
            on, at = palm, [0.03 - 0.02 * k, 0.0, -0.05 if k == 0 else -0.09]
            for joint in ("base", "middle", "tip"):
                on = add(f"{side}_{finger}_{joint}", on, "y", at if on == palm else [0, 0, -0.03])
    on = chest
    for joint, axis in (("pitch", "y"), ("roll", "x"), ("yaw", "z")):
        on = add(f"neck_{joint}", on, axis, [0, 0, 0.38] if on == chest else [0, 0, 0.05])
    shapes: list[list[dict[str, Any]]] = [
        [{"shape": "box", "size": [0.12, 0.22, 0.14], "color": "grey"}]
    ]
    for joint in names:
        ends = [frames[k][:3, 3] for k, parent in enumerate(parents) if parent == joint]
        thick = next((radius for word, radius in _RADII.items() if word in joint), 0.008)
        tips = [[0.0, 0.0, -0.025]] if not ends and thick < 0.01 else []
        ends += [turned[joint].T @ tip for tip in tips]
        shapes.append([_capsule(end, thick) for end in ends if np.linalg.norm(end) > 0.01])
        if not shapes[-1]:
            shapes[-1] = [{"shape": "sphere", "size": [1.3 * thick], "color": "dark"}]
    effort = [next((value for key, value in _EFFORT.items() if key in joint), 2.0)
              for joint in names]  # fmt: skip
    given: dict[str, Any] = {
        "joint_names": names, "parents": parents, "joint_frames": frames, "torque_limits": effort,
        "position_limits": [[-2.5, 2.5]] * len(names), "flange_on": "l_wrist_roll",
        "base_frame": {"xyz": [0.0, 0.0, 1.0]}, "fit_arrows": True, "filenames": shapes,
        "colors": {"grey": [0.75, 0.77, 0.8, 1.0], "dark": [0.25, 0.27, 0.3, 1.0]},
    }  # fmt: skip
    return SerialRobot(name=name, **{**given, **fields})
