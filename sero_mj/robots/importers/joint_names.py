"""Names of joints: the names in the robot's file, with any printable characters.

In compiled models a joint is called `ROBOT/JOINT`, split at the first slash. Routes use identifiers
instead: `left_j1` stands for `left/j1`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from ...base.errors import mismatch

BASE = "base"  # parent of joints without a parent joint
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
    """Returns valid and unique names of joints, and a description of each change."""
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
    """Returns a joint's name in routes, with `_` for other characters: `left_j1` for `left/j1`."""
    plain = re.sub(r"[^A-Za-z0-9_-]+", "_", name)
    return plain if re.match(r"[A-Za-z_]", plain) else f"_{plain}"


def identifiers(names: Sequence[str]) -> dict[str, int]:
    """Returns joint indices by identifier, without ambiguous identifiers and names of joints."""
    found = [identifier(name) for name in names]
    return {each: k for k, each in enumerate(found) if found.count(each) == 1 and each not in names}


def parents_of(links: Iterable[int], names: Sequence[str]) -> list[str]:
    """Returns the entries of `parents` in a robot file.

    `links` has the parent link of each joint: 0 for the base, i for joint i. A joint that is called
    `base` is referred to by its link, such as `link2`.
    """
    return [
        BASE if not link else f"link{link}" if names[link - 1] == BASE else names[link - 1]
        for link in links
    ]


def link_of_parent(parent: str, names: Sequence[str]) -> int | None:
    """Returns the parent link of an entry of `parents`, see `parents_of`; None if unknown."""
    if parent == BASE:
        return 0
    if parent in names:
        return names.index(parent) + 1
    links = [f"link{i + 1}" for i in range(len(names))]
    return links.index(parent) + 1 if parent in links else None
