"""Formats the tables of a robot as a TOML robot file with comments."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...base.frames import quat_from_rotation
from .imported_tables import ImportedTables
from .toml_text import inline, toml_entry

_SCHEMA = "#:schema ./robot.schema.json"
_ZERO = 1e-15  # maximum rounding error of zero, in m, rad or kg m2
_MAX_COLUMN_WIDTH = 60  # maximum width of a column of entries before comments


def robot_text(
    described: ImportedTables,
    tables: Mapping[str, Any],
    limbs: Mapping[str, Sequence[int]],
    *,
    file: str,
    bodies: Sequence[Sequence[str]],
    flange: str,
) -> str:
    """Returns the text of a robot file for an imported robot, with comments.

    Args:
        limbs: joint indices by limb name.
        bodies: names of the original links that form the base and each link.
        flange: comment about the flange.
    """
    text = _RobotText(bodies, _rounded(tables))
    lines = [
        f"Converted from {file} by `sero-mj import`. Lengths in m, angles in rad, masses in kg,",
        "torques in Nm (prismatic joints: forces in N). Links joined by fixed joints are merged.",
    ]
    if described.warnings:
        lines += ["", "Differences from the original file:"]
        lines += [f"- {warning}" for warning in described.warnings]
    text.lines += [_SCHEMA, *(f"# {line}".rstrip() for line in lines)]
    text.add_kinematics(flange, limbs)
    text.add_limits()
    text.add_geometry()
    text.add_dynamics()
    return "\n".join(text.lines) + "\n"


class _RobotText:
    def __init__(self, bodies: Sequence[Sequence[str]], tables: Mapping[str, Any]) -> None:
        self.lines: list[str] = []
        self._tables = tables
        self._names: list[str] = tables["joint_names"]
        self._links = [", ".join(links) for links in bodies]
        self._of_joints = [f"{i + 1} {name}" for i, name in enumerate(self._names)]
        self._of_links = [f"base: {self._links[0]}"]
        self._of_links += [
            f"{name}: {links}" for name, links in zip(self._names, self._links[1:], strict=True)
        ]

    def _rows(self, key: str, values: Sequence[Any], notes: Sequence[str], about: str = "") -> None:
        self.lines += [*([f"# {about}"] if about else []), f"{key} = ["]
        texts = [f"  {inline(value)}," for value in values]
        width = min(max(map(len, texts), default=0), _MAX_COLUMN_WIDTH)
        self.lines += [f"{t:<{width}}  # {n}" for t, n in zip(texts, notes, strict=True)]
        self.lines.append("]")

    def _given(self, *keys: str, about: str = "") -> None:
        for key in keys:
            if key in self._tables:
                self.lines += [*([f"# {about}"] if about else [])]
                self.lines += toml_entry(key, self._tables[key])

    def _frame(self, key: str, about: str = "") -> None:
        if key in self._tables:
            note = f"  # {about}" if about else ""
            self.lines.append(f"{key} = {inline(frame_table(self._tables[key]))}{note}")

    def add_kinematics(self, flange: str, limbs: Mapping[str, Sequence[int]]) -> None:
        self.lines += ["#", f"# Limbs ({len(self._names)} joints). Routes can use these names:"]
        self.lines += [f"# - {self._limb(name, joints)}" for name, joints in limbs.items()]
        self.lines += ["", f"description = {inline(self._tables['description'])}", ""]
        if "dh_params" in self._tables:
            self._given("dh_convention")
            about = "alpha (rad), a (m), theta (rad), d (m)"
            self._rows("dh_params", self._tables["dh_params"], self._of_joints, about)
            self._frame("dh_base_frame", "frame 0 of the table, relative to the base")
        else:
            about = "frame of each link relative to its parent, at joint value zero; z: joint axis"
            frames = [frame_table(T) for T in self._tables["joint_frames"]]
            self._rows("joint_frames", frames, self._of_joints, about)
        self._given("joint_names", "joint_types")
        self._given("link_names", about="link names in the original file, base first")
        self._given("parents", about="for each joint, the joint whose link carries it")
        self._given("flange_on", about="the joint whose link carries the flange")
        self._frame("flange_frame", flange)
        self._given("free_base", "base_joint", "base_normal")
        self._frame("base_frame")

    def add_limits(self) -> None:
        self.lines.append("")
        for key, about in (
            ("position_limits", "rad or m; inf for none"),
            ("velocity_limits", "rad/s or m/s"),
            ("torque_limits", "Nm or N; arrows reach full width at these torques"),
        ):
            if key in self._tables:
                self._rows(key, self._tables[key], self._names, about)
        self._given("joint_angles", about="initial pose, because zero is outside the limits")
        self._given("fit_arrows", about="whether arrow sizes are fitted to the adjacent links")

    def add_geometry(self) -> None:
        self.lines.append("")
        self._given("directory")
        self._given("mjcf", about="visual and collision geoms, with the same joints")
        for key, about in (
            ("filenames", "visual shapes"),
            ("collisions", "collision shapes"),
        ):
            if key not in self._tables:
                continue
            self.lines += [f"# {about}", f"{key} = ["]
            for parts, note in zip(self._tables[key], self._of_links, strict=True):
                self.lines.append(f"  [  # {note}" if parts else f"  [],  # {note}")
                for part in parts:
                    at = {"frame": frame_table(part["frame"])} if "frame" in part else {}
                    self.lines.append(f"    {inline({**part, **at})},")
                self.lines += ["  ],"] if parts else []
            self.lines.append("]")

    def add_dynamics(self) -> None:
        for table in ("colors", "couplings", "link_frames"):
            if self._tables.get(table):
                self.lines += ["", f"[{table}]"]
                for key, value in self._tables[table].items():
                    at = {"frame": frame_table(value["frame"])} if table == "link_frames" else {}
                    self.lines += toml_entry(key, {**value, **at} if at else value)
        if "dynamics" not in self._tables:
            return
        self.lines += ["", "# Per link, base first, in link frames. Missing values are estimated."]
        self.lines.append("[dynamics]")
        about = {
            "masses": "kg",
            "centers_of_mass": "m",
            "inertias": "Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the center of mass, kg m2",
            "motor_inertias": "kg m2, at the joint (after the gear)",
            "viscous_friction": "Nm s/rad or N s/m",
            "coulomb_friction": "Nm or N",
        }
        for key, value in self._tables["dynamics"].items():
            if isinstance(value, list):
                notes = self._names if len(value) == len(self._names) else self._of_links
                self._rows(key, value, notes, about[key])
            else:
                self.lines += toml_entry(key, value)

    def _limb(self, name: str, joints: Sequence[int]) -> str:
        first, last = joints[0], joints[-1]
        parents = self._tables.get("parents", ["base", *self._names[:-1]])
        which = f"joint {first + 1}" if first == last else f"joints {first + 1} to {last + 1}"
        between = [self._names[first]] if first == last else [self._names[i] for i in (first, last)]
        on = f"on {parents[first]}, to {self._links[last + 1]}"
        return f"{name}: {which}, {' ... '.join(between)}, {on}"


def _rounded(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _rounded(each) for key, each in value.items()}
    if isinstance(value, np.ndarray):
        return _rounded(value.tolist())
    if isinstance(value, list | tuple):
        return [_rounded(each) for each in value]
    if isinstance(value, float):
        return 0.0 if abs(value) < _ZERO else float(f"{value:.15g}")
    return value


def frame_table(T: Any) -> dict[str, list[float]]:
    """Converts a frame (4, 4) to a table with `xyz` and `quat`, without entries that are zero."""
    T = np.asarray(T, np.float64)
    table = {}
    if (np.abs(T[:3, 3]) > _ZERO).any():
        table["xyz"] = _rounded(T[:3, 3].tolist())
    if np.abs(T[:3, :3] - np.eye(3)).max() > _ZERO:
        table["quat"] = _rounded(quat_from_rotation(T[:3, :3]).tolist())
    return table or {"xyz": [0.0, 0.0, 0.0]}


def copied_meshes(tables: Mapping[str, Any], copy: Callable[[Path, str], None]) -> dict[str, Any]:
    """Copies the meshes of a robot to the folder `meshes`, and returns tables that use them.

    `copy` is called with each mesh file and its name in this folder.
    """
    result = dict(tables)
    folder = Path(result.get("directory", ""))
    names = {
        part["file"]
        for key in ("filenames", "collisions")
        for link in tables.get(key, [])
        for part in link
        if "file" in part
    }
    for name in sorted(names):
        copy(folder / name, name)
    if names:
        result["directory"] = "meshes"
    return result
