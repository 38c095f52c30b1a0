"""Limbs are unbranched parts of a robot. They group joints in routes, toggles and panels."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence

from ...base.errors import Problem

_SMALL = r"[^\W\d_A-Z]"  # any letter except ASCII capitals
_WORDS = re.compile(rf"[A-Z]+(?!{_SMALL})|[A-Z]?{_SMALL}+|\d+")
_GENERIC_WORDS = ("joint", "j")  # words that do not identify a limb
# Words that identify a part of the body, for limbs whose joint names share no word.
_PARTS = {
    "arm": ("shoulder", "elbow", "forearm", "wrist"),
    "leg": ("hip", "thigh", "knee", "calf", "ankle"),
    "head": ("neck", "eye"),
    "torso": ("waist", "spine"),
    "hand": ("finger", "thumb", "knuckle"),
}
_PART_OF = {word: part for part, words in _PARTS.items() for word in (part, *words)}


def find_limbs(
    names: Sequence[str], carriers: Sequence[int], followed: Mapping[str, str]
) -> dict[str, list[int]]:
    """Returns the joint indices of each limb, by name. Each joint belongs to exactly one limb.

    A limb is a maximal sequence of joints in which each joint is the only child of the previous
    one. A sequence of coupled joints belongs to the limb of its driving joint. The name of a limb
    is the common part of its joint names, or else consists of the first and the last joint name.

    Args:
        names: joint names.
        carriers: number of the parent joint of each joint, from 1, or 0 for the base.
        followed: driving joints by the names of coupled joints.
    """
    on = Counter(carriers)
    runs: list[list[int]] = []
    for i, carrier in enumerate(carriers):
        if runs and carrier == i and on[carrier] == 1:
            runs[-1].append(i)
        else:
            runs.append([i])
    runs = _with_followers(runs, names, followed)
    found = [limb_name([names[i] for i in run]) for run in runs]
    known = Counter(found)
    limbs: dict[str, list[int]] = {}
    for run, name in zip(runs, found, strict=True):
        is_clear = name and known[name] == 1 and (name not in names or len(run) == 1)
        limbs[name if is_clear else _ends(names, run)] = run
    return limbs


def limb_problems(names: Sequence[str], limbs: Mapping[str, Sequence[str]]) -> list[Problem]:
    """Returns problems with names and joints of declared limbs that are unknown or used twice."""
    problems = []
    limb_of: dict[str, str] = {}
    for limb, joints in limbs.items():
        if limb in names and list(joints) != [limb]:
            message = "a joint already has this name; expected a different name"
            problems.append(Problem(limb, message))
        if not joints:
            problems.append(Problem(limb, "found no joints; expected one or more"))
        for i, joint in enumerate(joints):
            if joint not in names:
                problems.append(Problem(f"{limb}.{i}", "no joint", found=joint, available=names))
            elif joint in limb_of:
                message = f"{joint} is already in {limb_of[joint]}; expected it in only one limb"
                problems.append(Problem(f"{limb}.{i}", message))
            limb_of.setdefault(joint, limb)
    return problems


def all_limbs(
    names: Sequence[str], found: Mapping[str, list[int]], declared: Mapping[str, Sequence[str]]
) -> dict[str, list[int]]:
    """Returns joint indices by limb, declared or (for the remaining joints) detected (`found`)."""
    index = {name: i for i, name in enumerate(names)}
    limbs = {limb: [index[joint] for joint in joints] for limb, joints in declared.items()}
    taken = {i for joints in limbs.values() for i in joints}
    for limb, joints in found.items():
        left = [i for i in joints if i not in taken]
        if left:
            is_whole = len(left) == len(joints) and limb not in limbs
            limbs[limb if is_whole else _ends(names, left)] = left
    return dict(sorted(limbs.items(), key=lambda entry: entry[1][0]))


def _with_followers(
    runs: list[list[int]], names: Sequence[str], followed: Mapping[str, str]
) -> list[list[int]]:
    number = {names[i]: k for k, run in enumerate(runs) for i in run}

    def leader(k: int) -> int:
        own = [names[i] for i in runs[k]]
        if not all(name in followed for name in own):
            return k
        name, seen = own[0], set[str]()
        while name in followed and name not in seen:
            seen.add(name)
            name = followed[name]
        return number.get(name, k)

    whole: dict[int, list[int]] = {}
    for k, run in enumerate(runs):
        whole.setdefault(leader(k), []).extend(run)
    return sorted((sorted(run) for run in whole.values()), key=lambda run: run[0])


def _ends(names: Sequence[str], run: Sequence[int]) -> str:
    first, last = names[run[0]], names[run[-1]]
    return first if len(run) == 1 else f"{first}-{last}"


def limb_name(joints: Sequence[str]) -> str:
    """Returns the words that all joint names share, joined by `_`; may be empty."""
    if len(joints) == 1:
        return joints[0]
    words = [_WORDS.findall(name) for name in joints]
    shared = set.intersection(*({word.lower() for word in each} for each in words))
    common = [
        word
        for word in dict.fromkeys(words[0])
        if word.lower() in shared and not word.isdigit() and word.lower() not in _GENERIC_WORDS
    ]
    words_of_all = {word.lower() for each in words for word in each}
    parts = {_PART_OF[word] for word in words_of_all if word in _PART_OF}
    told = any(
        word in _PART_OF or part in word for word in map(str.lower, common) for part in parts
    )
    return "_".join([*common, *parts] if len(parts) == 1 and not told else common)
