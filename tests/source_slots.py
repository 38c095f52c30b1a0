"""Writes and reads the counters of sources in `MjData`, like a mirror."""

from __future__ import annotations

import mujoco

from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.inputs import SOURCE_FIELDS

NOTHING_YET = {
    "age": -1,
    "fault_age": -1,
    "robot_state": -1,
    "link_quality": -1,
    "link_age": -1,
    "foreign_age": -1,
}


def set_source(data: mujoco.MjData, world: World, name: str, **counts: float) -> None:
    """Sets the counters of a source that has received nothing; other counters are zero."""
    assert counts.keys() <= set(SOURCE_FIELDS)
    given = dict.fromkeys(SOURCE_FIELDS, 0) | NOTHING_YET | counts
    data.userdata[world.slots[f"sources.{name}"]] = list(given.values())


def get_source(data: mujoco.MjData, world: World, name: str) -> dict[str, float]:
    """Returns the counters of a source that differ from their initial values."""
    values = data.userdata[world.slots[f"sources.{name}"]].tolist()
    before = dict.fromkeys(SOURCE_FIELDS, 0) | NOTHING_YET
    found = zip(SOURCE_FIELDS, values, strict=True)
    return {key: value for key, value in found if value != before[key]}
