"""Writes an identified robot as a robot file, URDF or MJCF."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from lxml import etree

from ....base.declaration import changed_fields
from ....base.errors import Problem
from ....base.frames import Array, inverse
from ....robots.assemble.robot_dynamics import robot_dynamics
from ....robots.declared.robot import SerialRobot
from ....robots.declared.scene import Scene
from ....robots.importers.toml_text import toml_text
from .identify_links import WholeRobot

_GEOMETRY = ("filenames", "collisions", "colors", "mesh_scale", "mjcf")
_TENSOR = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2),
           "izz": (2, 2)}  # fmt: skip
_DECIMALS = 13  # of all other values
_DIGITS = 7  # significant digits of identified values


def write_identified(whole: WholeRobot, path: Path) -> None:
    """Writes the identified robot; the name of the file ends in .toml, .urdf or .xml.

    Raises:
        UsageError: the robot is not from a URDF file, which is required for URDF.
        OSError: the file cannot be written.
    """
    ending = path.suffix.lower()
    if ending == ".toml":
        path.write_text(robot_file(whole, path.parent), encoding="utf-8")
    elif ending == ".urdf":
        path.write_bytes(_urdf(whole))
    else:
        from ....robots.assemble.world import World

        World(Scene(robots=[whole.identified], floor=False)).export(path)
        text = path.read_text("utf-8")
        head, opening, rest = text.partition("<mujoco")
        path.write_text(f"{head}{_xml_comment(whole)}\n{opening}{rest}", encoding="utf-8")


def about(whole: WholeRobot) -> list[str]:
    """Returns lines about the identification, with all estimates and their standard errors."""
    lines = [f"Identified from {whole.run}, {whole.begin:.3f} s to {whole.end:.3f} s.",
             "Estimates with standard errors. The links below fit these sums and are otherwise",
             "close to the declared ones:"]  # fmt: skip
    for name, (estimate, unit) in whole.named().items():
        shown = (
            str(estimate) if estimate.value is not None else f"not identified: {estimate.reason}"
        )
        lines.append(f"- {name}: {shown} {unit}".rstrip())
    return lines + [f"Not identified: {each}" for each in whole.reasons]


def robot_file(whole: WholeRobot, folder: Path) -> str:
    """Returns the text of a robot file in `folder`, with the estimates as comments."""
    robot = whole.identified
    fields = _without_noise(changed_fields(robot, "name", "dynamics"))
    meshes = Path(robot.directory)
    if robot.directory and meshes.is_dir():
        fields["directory"] = os.path.relpath(meshes.absolute(), folder.absolute())
    else:  # a recording has no meshes
        for key in ("directory", *_GEOMETRY):
            fields.pop(key, None)
    dynamics = changed_fields(robot.dynamics)
    fields["dynamics"] = {key: _rounded(value) for key, value in dynamics.items()}
    fields["dynamics"]["inertias"] = [
        _rounded([tensor[i][j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))])
        for tensor in dynamics["inertias"]
    ]
    return toml_text(fields, about(whole))


def _without_noise(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_noise(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_without_noise(each) for each in value]
    return round(value, _DECIMALS) + 0.0 if isinstance(value, float) else value


def _rounded(value: Any) -> Any:
    if isinstance(value, list):
        return [_rounded(each) for each in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def _urdf(whole: WholeRobot) -> bytes:
    robot, source = whole.identified, whole.robot._model
    if source is None or source.suffix.lower() != ".urdf":
        found = f"robot '{robot.name}' is not from a URDF file"
        expected = "--scene robot.urdf, or an output file that ends in .toml or .xml"
        raise Problem("--output", found, expected=expected).error()
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
    root = etree.parse(str(source), parser).getroot()
    root.insert(0, etree.Comment(f"\n{_comment_text(whole)}\n"))
    dynamics, written = robot_dynamics(robot), set[int]()
    for name, (i, T) in robot.link_poses.items():
        link = next((each for each in root.findall("link") if each.get("name") == name), None)
        if link is None or i == 0:
            continue
        for old in link.findall("inertial"):
            link.remove(old)
        if i not in written:  # links that are fixed to this one have no mass of their own
            link.append(_inertial(dynamics.masses[i], dynamics.centers[i], dynamics.tensors[i], T))
            written.add(i)
    _set_friction(root, whole)
    etree.indent(root)
    return bytes(etree.tostring(root, xml_declaration=True, encoding="utf-8", pretty_print=True))


def _inertial(mass: float, center: Array, tensor: Array, T_link_original: Array) -> Any:
    T = inverse(T_link_original)
    c, tensor = T[:3, :3] @ center + T[:3, 3], T[:3, :3] @ tensor @ T[:3, :3].T
    element = etree.Element("inertial")
    xyz = " ".join(f"{each:.{_DIGITS}g}" for each in c)
    etree.SubElement(element, "origin", xyz=xyz, rpy="0 0 0")
    etree.SubElement(element, "mass", value=f"{mass:.{_DIGITS}g}")
    entries = {key: f"{tensor[at]:.{_DIGITS}g}" for key, at in _TENSOR.items()}
    etree.SubElement(element, "inertia", entries)
    return element


def _set_friction(root: Any, whole: WholeRobot) -> None:
    declared: SerialRobot = whole.identified
    names = dict(zip(declared.names, range(declared.n), strict=True))
    for joint in root.findall("joint"):
        k = names.get(joint.get("name", ""))
        for key, values in (("damping", declared.dynamics.viscous_friction),
                            ("friction", declared.dynamics.coulomb_friction)):  # fmt: skip
            if k is not None and values is not None:
                element = joint.find("dynamics")
                if element is None:
                    element = etree.SubElement(joint, "dynamics")
                element.set(key, f"{values[k]:.{_DIGITS}g}")


def _comment_text(whole: WholeRobot) -> str:
    return "\n".join(about(whole)).replace("--", "- -")


def _xml_comment(whole: WholeRobot) -> str:
    return f"<!--\n{_comment_text(whole)}\n-->"
