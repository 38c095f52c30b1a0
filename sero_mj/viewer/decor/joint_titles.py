"""Titles of joints and frames: names of limited length without repeated parts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from itertools import takewhile

from .font import drawable
from .image_view import ImageView

SHORTEST, LONGEST = 14, 40  # range of the maximum length of a name, characters
_SHARE = 0.25  # maximum width of a name, fraction of the image width
_BETWEEN = r"[_\-\s/:.]+"  # separators between the words of a name
_WORD = r"[^_\-\s/:.]*"
_GENERIC = ("joint", "jnt", "j", "link")
_END = re.compile(rf"({_BETWEEN}({'|'.join(_GENERIC)}))+$", re.IGNORECASE)


def short_joint_names(joints: Sequence[str], robot: str) -> list[str]:
    """Returns the joint names of a robot without repeated parts.

    This removes the name of the robot at the start, the words that all names begin with, and words
    such as `joint` at the end. Nothing is removed if the names would no longer be distinct or would
    be only numbers. If no available font has the characters of a name, a name such as `joint 3`
    replaces it.
    """
    own = re.compile(rf"^{re.escape(robot)}{_BETWEEN}(?=.)", re.IGNORECASE)
    names = _if_clear(list(joints), [own.sub("", name) for name in joints])
    words = [re.split(_BETWEEN, name) for name in names]
    for count in range(min(map(len, words), default=1) - 1, 0, -1):
        if len(names) > 1 and len({tuple(of_name[:count]) for of_name in words}) == 1:
            start = re.compile(rf"^({_WORD}{_BETWEEN}){{{count}}}")
            plain = _if_clear(names, [start.sub("", name) for name in names])
            if plain != names:  # `joint_1` is not changed
                names = plain
                break
    names = _if_clear(names, [_END.sub("", name) for name in names])
    return [name if drawable(name) else f"joint {k + 1}" for k, name in enumerate(names)]


def _if_clear(names: list[str], plain: list[str]) -> list[str]:
    is_clear = all(re.search("[A-Za-z]", n) and n.lower() not in _GENERIC for n in plain)
    return plain if is_clear and len({*plain}) == len({*names}) else names


def longest_name(view: ImageView) -> int:
    """Returns the maximum length of the names on the billboards of an image, in characters."""
    room = _SHARE * view.width / view.font.width("n")
    return int(min(max(room, SHORTEST), LONGEST))


def titles(
    joints: Sequence[Sequence[str]],
    owners: Sequence[str],
    is_named: Sequence[bool],
    longest: int = SHORTEST,
) -> list[str]:
    """Returns the titles of the billboards of all joints.

    Args:
        joints: short joint names of each robot or double.
        owners: names of the robots and doubles. Words that all of them begin with are removed.
        is_named: whether the titles contain the name of the robot or double, for each of them.
        longest: maximum length of the name of a robot, double or joint, characters.
    """
    of_joints = iter(shortened([name for names in joints for name in names], longest))
    owners = without_common_start(owners)
    found = []
    for owner, short, names, with_owner in zip(
        owners, shortened(owners, longest), joints, is_named, strict=True
    ):
        for name in names:
            joint = next(of_joints)
            # The only joint of a body often has the name of the body.
            is_same = len(names) == 1 and name.lower() in owner.lower()
            title = short if is_same else f"{short} {joint}"
            found.append(title if with_owner else joint)
    return found


def without_common_start(owners: Sequence[str]) -> list[str]:
    """Returns the names of robots and doubles without the words that all of them begin with."""
    words = [name.split("_") for name in owners]
    same = 0
    if len(words) > 1:
        columns = zip(*(of_name[:-1] for of_name in words), strict=False)
        same = sum(1 for _ in takewhile(lambda column: len({*column}) == 1, columns))
    return _if_clear(list(owners), ["_".join(of_name[same:]) for of_name in words])


@lru_cache(maxsize=16)  # called for each frame
def frame_titles(names: tuple[str, ...]) -> list[str]:
    """Returns frame names, without the words with which the names of all robots begin."""
    owners = list(dict.fromkeys(name.partition("/")[0] for name in names if "/" in name))
    short = dict(zip(owners, without_common_start(owners), strict=True))
    return [
        f"{short[owner]}/{frame}" if slash else name
        for name in names
        for owner, slash, frame in [name.partition("/")]
    ]


def shortened(names: Sequence[str], longest: int = SHORTEST) -> list[str]:
    """Replaces the middle of names that exceed `longest` characters with two dots.

    Names that would become equal are shortened less.
    """

    def at_most(name: str, length: int) -> str:
        half = (length - 2) // 2
        return name if len(name) <= length else f"{name[:half]}..{name[-half:]}"

    lengths = dict.fromkeys(names, longest)
    while True:
        short = {name: at_most(name, length) for name, length in lengths.items()}
        texts = list(short.values())
        same = [name for name, text in short.items() if texts.count(text) > 1 and text != name]
        if not same:
            return [short[name] for name in names]
        for name in same:
            lengths[name] += 2
