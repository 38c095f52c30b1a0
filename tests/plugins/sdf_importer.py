"""A plug-in: an importer for chains of joints in SDF, the format of Gazebo.

It reads models whose links and joints have plain poses (sdformat.org/spec). The pose of a
link is in the frame of the model, the pose of a joint in the frame of its child. Its
pyproject.toml has:

    [project.entry-points."sero_mj.importers"]
    sdf = "sdf_importer:Sdf"
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from sero_mj.base.errors import DeclarationError, Problem
from sero_mj.base.frames import Array, frame, inverse, rotation_from_rpy, rotation_to_z
from sero_mj.robots.importers.imported_tables import ImportedTables
from sero_mj.robots.importers.importer import Importer

KINDS = {"revolute": "revolute", "prismatic": "prismatic"}


def pose_of(element: Element) -> Array:
    """Returns the pose of an element (4, 4) from x y z (m) and roll pitch yaw (rad)."""
    numbers = np.array((element.findtext("pose") or "0 0 0 0 0 0").split(), float)
    return frame(rotation_from_rpy(numbers[3:]), numbers[:3])


class Sdf(Importer):
    """Reads the first model of a file."""

    endings: ClassVar[tuple[str, ...]] = (".sdf",)

    @classmethod
    def takes(cls, path: Path, head: bytes) -> bool:
        """See `Importer`."""
        return b"<sdf" in head

    def read(
        self,
        path: Path,
        packages: Mapping[str, Path | str] | None = None,
        arguments: Mapping[str, Any] | None = None,
    ) -> ImportedTables:
        """See `Importer`."""
        model = ElementTree.fromstring(path.read_bytes()).find(".//model")
        if model is None:
            raise DeclarationError([Problem("", "has no <model>", str(path))])
        links = {link.get("name", ""): link for link in model.iter("link")}
        joints = [joint for joint in model.iter("joint") if joint.get("type") in KINDS]
        on, frames, parents, limits = {}, [], [], []
        for joint in joints:
            parent, child = joint.findtext("parent", ""), joint.findtext("child", "")
            axis = np.array((joint.findtext("axis/xyz") or "0 0 1").split(), float)
            # z of the joint's frame is its axis.
            T = pose_of(links[child]) @ pose_of(joint)
            T = T @ frame(rotation_to_z(np.eye(3), axis / np.linalg.norm(axis)))
            before = on.get(parent)
            frames.append(T if before is None else inverse(before[1]) @ T)
            parents.append("base" if before is None else before[0])
            on[child] = (joint.get("name", ""), T)
            low = joint.findtext("axis/limit/lower")
            high = joint.findtext("axis/limit/upper")
            limits.append([float(low or -np.pi), float(high or np.pi)])
        base = next(name for name in links if name not in on)
        return ImportedTables({
            "joint_frames": [T.tolist() for T in frames],
            "joint_names": [joint.get("name") for joint in joints],
            "joint_types": [KINDS[joint.get("type", "")] for joint in joints],
            "parents": parents,
            "link_names": [base, *on],
            "position_limits": limits,
        })  # fmt: skip
