"""Converts and checks names of joints, which can contain any printable characters.

Joints have the names in the robot's file. In compiled models, a joint is called `ROBOT/JOINT`,
which is split at the first slash. Routes use identifiers instead: `left_j1` stands for `left/j1`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from ...base.errors import mismatch

BASE = "base"  # entry of `parents` for joints without a parent joint
MAX_LENGTH = 200  # characters


def is_joint_name(name: str) -> str:
    """Returns a valid joint name unchanged, such as `1`, `left/j1`, `a.b` or `hüfte`.

    Raises ValueError for names that are empty, too long, or not printable.
    """
    if not name.strip() or not name.isprintable() or len(name) > MAX_LENGTH:
        expected = f"1 to {MAX_LENGTH} printable characters"
        raise mismatch(name, expected)
    return name


def joint_names_of(names: Iterable[str]) -> tuple[list[str], list[str]]:
    """Returns joint names, made valid and unique, and a description of each change."""
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
    """Returns the name of a joint in routes, such as `left_j1` for `left/j1`."""
    plain = re.sub(r"[^A-Za-z0-9_-]+", "_", name)
    return plain if re.match(r"[A-Za-z_]", plain) else f"_{plain}"


def identifiers(names: Sequence[str]) -> dict[str, int]:
    """Returns a mapping from identifiers to joint indices.

    It does not contain identifiers that are ambiguous or are names of joints.
    """
    found = [identifier(name) for name in names]
    return {each: k for k, each in enumerate(found) if found.count(each) == 1 and each not in names}


def parents_of(links: Iterable[int], names: Sequence[str]) -> list[str]:
    """Returns the entries of `parents` in a robot file.

    `links` contains the parent link of each joint: 0 for the base, and i for the link of joint i. A
    joint with the name `base` is referred to by its link, such as `link2`.
    """
    return [
        BASE if not link else f"link{link}" if names[link - 1] == BASE else names[link - 1]
        for link in links
    ]


def link_of_parent(parent: str, names: Sequence[str]) -> int | None:
    """Returns the link of an entry of `parents`, see `parents_of`, or None if it is unknown."""
    if parent == BASE:
        return 0
    if parent in names:
        return names.index(parent) + 1
    links = [f"link{i + 1}" for i in range(len(names))]
    return links.index(parent) + 1 if parent in links else None
