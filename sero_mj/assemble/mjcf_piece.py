"""Pieces of MJCF that a scene brings along, read so that they fit into ours."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from dm_control import mjcf

from ..errors import DeclarationError, Problem
from ..files import open_file

_MOST_BYTES = 100_000_000
_JOINT_ANGLES = ("range", "ref", "springref")


def read_piece(source: str, folder: Path) -> mjcf.RootElement:
    """Reads a piece of MJCF and turns its angles into radians, which our models use.

    PyMJCF merges the `angle` of all parts into one, and its own default is none; MuJoCo's is
    degrees, so that is what a piece means that says nothing.

    Args:
        source: a file's name, or text that starts with `<`.
        folder: where the name, and the files that the piece names, start from.

    Raises:
        DeclarationError: it cannot be read.
    """
    try:
        if source.lstrip().startswith("<"):
            piece = mjcf.from_xml_string(source, model_dir=str(folder))
        else:
            open_file(folder / source, _MOST_BYTES).close()
            piece = mjcf.from_path(str(folder / source))
    except OSError as error:
        reason = error.strerror or str(error)
        raise DeclarationError([Problem("mjcf", f"cannot be read: {reason}")]) from error
    except Exception as error:  # PyMJCF raises lxml's, OS and value errors alike
        raise DeclarationError([Problem("mjcf", f"cannot be read: {error}")]) from error
    if piece.compiler.angle != "radian":
        for element in _elements(piece):
            _to_radians(element)
        piece.compiler.angle = "radian"
    return piece


def _elements(element: Any) -> Iterator[Any]:
    yield element
    for child in element.all_children():
        yield from _elements(child)


def _to_radians(element: Any) -> None:
    attributes = element.get_attributes()
    if "euler" in attributes:
        element.euler = [math.radians(angle) for angle in element.euler]
    if "axisangle" in attributes:
        element.axisangle = [*element.axisangle[:3], math.radians(element.axisangle[3])]
    if element.tag == "joint" and _joint_type(element) in ("hinge", "ball"):
        for name in _JOINT_ANGLES:
            if name in attributes:
                value = getattr(element, name)
                turned = [math.radians(angle) for angle in value] if name == "range" else None
                setattr(element, name, math.radians(value) if turned is None else turned)


def _joint_type(joint: Any) -> str:
    """The type of a joint, its own or that of its default class."""
    if joint.type is not None:
        return str(joint.type)
    dclass = getattr(joint, "dclass", None) or getattr(joint.root, "default", None)
    inherited = getattr(getattr(dclass, "joint", None), "type", None)
    return str(inherited or "hinge")
