"""Names of joints: those of the robot's own file, in any characters that can be printed.

Messages and tables name joints in the same way, and everything shown has these names. In compiled
models a joint is called `ROBOT/JOINT`, divided at the first slash. Routes are written in a language
of identifiers: there, `left_j1` stands for `left/j1`, see `identifier`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from ...base.errors import mismatch

BASE = "base"  # the parent of joints without a parent joint
LONGEST = 200  # characters


def is_joint_name(name: str) -> str:
    """Returns the name if a joint can have it: `1`, `left/j1`, `a.b`, `hüfte`, but no line breaks.

    Raises ValueError if it is empty, too long, or has characters that cannot be printed.
    """
    if not name.strip() or not name.isprintable() or len(name) > LONGEST:
        expected = f"1 to {LONGEST} characters that can be printed"
        raise mismatch(name, expected)
    return name


def joint_names_of(names: Iterable[str]) -> tuple[list[str], list[str]]:
    """Returns names of joints for a robot file, and a description of each one that was changed.

    Changed are names that no joint can have, and the later ones of two equal names.
    """
    found: list[str] = []
    changed = []
    for name in names:
        plain = "".join(c if c.isprintable() else "_" for c in name).strip()[:LONGEST] or "joint"
        plain = plain if plain != name.strip() else name
        unique, count = plain, 1
        while unique in found:
            count += 1
            unique = f"{plain}_{count}"
        found.append(unique)
        if unique != name:
            changed.append(f"{name!r} is {unique}")
    return found, changed


def identifier(name: str) -> str:
    """Returns a joint's name with `_` for all that routes cannot have: `left_j1` of `left/j1`."""
    plain = re.sub(r"[^A-Za-z0-9_-]+", "_", name)
    return plain if re.match(r"[A-Za-z_]", plain) else f"_{plain}"


def identifiers(names: Sequence[str]) -> dict[str, int]:
    """Returns indices of joints by their identifiers, without ambiguous ones and joints' names."""
    found = [identifier(name) for name in names]
    return {each: k for k, each in enumerate(found) if found.count(each) == 1 and each not in names}


def parents_of(links: Iterable[int], names: Sequence[str]) -> list[str]:
    """Returns the entries of `parents` in a robot file, by the link that carries each joint.

    It is 0 for the base, i for the link of joint i. A joint called `base` is referred to by its
    link, `link2`.
    """
    return [
        BASE if not link else f"link{link}" if names[link - 1] == BASE else names[link - 1]
        for link in links
    ]


def link_of_parent(parent: str, names: Sequence[str]) -> int | None:
    """Returns the link that an entry of `parents` means, see `parents_of`; None for no link."""
    if parent == BASE:
        return 0
    if parent in names:
        return names.index(parent) + 1
    links = [f"link{i + 1}" for i in range(len(names))]
    return links.index(parent) + 1 if parent in links else None
