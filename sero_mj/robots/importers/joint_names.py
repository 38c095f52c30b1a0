"""Checks and converts names of joints, which can contain any printable characters.

Joints keep their names from the robot file. In a compiled model, the joint is named `ROBOT/JOINT`,
and the first slash separates the names. Routes use identifiers, such as `left_j1` for `left/j1`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from ...base.errors import mismatch

BASE = "base"  # entry of `parents` for joints without a parent joint
MAX_LENGTH = 200  # maximum length of a joint name, characters


def is_joint_name(name: str) -> str:
    """Returns a joint name unchanged if it is valid, for example `1`, `left/j1`, `a.b` or `hüfte`.

    Raises DeclarationError if the name is empty, too long, or not printable.
    """
    if not name.strip() or not name.isprintable() or len(name) > MAX_LENGTH:
        expected = f"1 to {MAX_LENGTH} printable characters"
        raise mismatch(name, expected)
    return name


def joint_names_of(names: Iterable[str]) -> tuple[list[str], list[str]]:
    """Makes joint names valid and unique. Returns the names and a description of each change."""
    found: list[str] = []
    changed = []
    for name in names:
        plain = "".join(c if c.isprintable() else "_" for c in name).strip()[:MAX_LENGTH] or "joint"
        plain = plain if plain != name.strip() else name
        unique, count = plain, 1
        while unique in found:
            count += 1
            unique = f"{plain}_{count}"
        found.append(unique)
        if unique != name:
            changed.append(f"{name!r} to {unique}")
    return found, changed


def identifier(name: str) -> str:
    """Returns the identifier of a joint for routes, such as `left_j1` for `left/j1`."""
    plain = re.sub(r"[^A-Za-z0-9_-]+", "_", name)
    return plain if re.match(r"[A-Za-z_]", plain) else f"_{plain}"


def identifiers(names: Sequence[str]) -> dict[str, int]:
    """Returns the indices of joints by their identifiers for routes.

    Identifiers that are ambiguous or that are also names of joints are omitted.
    """
    found = [identifier(name) for name in names]
    return {each: k for k, each in enumerate(found) if found.count(each) == 1 and each not in names}


def parents_of(links: Iterable[int], names: Sequence[str]) -> list[str]:
    """Returns the field `parents` of a robot file.

    Args:
        links: index of the parent link of each joint, 0 for the base and i for the link of joint i.
        names: joint names. A joint named `base` is replaced by its link, such as `link2`.
    """
    return [
        BASE if not link else f"link{link}" if names[link - 1] == BASE else names[link - 1]
        for link in links
    ]


def link_of_parent(parent: str, names: Sequence[str]) -> int | None:
    """Returns the link index for an entry of `parents`, or None if the entry is unknown."""
    if parent == BASE:
        return 0
    if parent in names:
        return names.index(parent) + 1
    links = [f"link{i + 1}" for i in range(len(names))]
    return links.index(parent) + 1 if parent in links else None
