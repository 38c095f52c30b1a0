"""Route expressions are checked when the scene is read: names, shapes, units, cycles."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from route_scenes import messages, scene_of

from sero_mj.data.drive.wiring import wire
from sero_mj.robots.declared.inputs import list_inputs


@pytest.mark.parametrize(
    ("target", "origin", "message"),
    [
        ("lwr.joint_angles", "udp.values2[1:]", ""),
        ("lwr.joint_angles", "udp.values2[0:1]", "udp.values2[0:1] has 1 value, but "
         "lwr.joint_angles takes 2, one per joint"),
        ("lwr.joint_angles", "udp.values2 * deg", "udp.values2 * deg has 3 values, but "
         "lwr.joint_angles takes 2, one per joint"),
        ("lwr.joint_angles", "udp.values0 * deg", ""),
        ("lwr.joint_angles", "udp.values0 * mm", "udp.values0 * mm is a length (m), but "
         "lwr.joint_angles takes an angle (rad)"),
        ("crane.joint_angles", "udp.values0 * mm", ""),
        ("crane.joint_angles", "udp.values0 * deg", "udp.values0 * deg is an angle (rad), but "
         "crane.joint_angles takes a length (m)"),
        ("mixed.joint_angles", "[udp.values0[0] * deg, udp.values0[1] * mm]", ""),
        ("mixed.joint_angles", "udp.values0 * deg", "udp.values0 * deg is an angle (rad), but "
         "mixed.joint_angles takes a length (m) at index 1"),
        ("mixed.joint_angles", "lwr.joint_angles", "lwr.joint_angles is an angle (rad), but "
         "mixed.joint_angles takes a length (m) at index 1"),
        ("mixed.joint_angles", "1 * deg", "1 * deg is an angle (rad), but "
         "mixed.joint_angles takes a length (m) at index 1"),
        ("mixed.torques", "[udp.values0[0] * mNm, udp.values0[1] * kN]", ""),
        ("crane.torques", "udp.values0 * Nm", "udp.values0 * Nm is a torque (Nm), but "
         "crane.torques takes a force (N)"),
        ("lwr.joint_accelerations", "udp.values0 * deg / s / s", ""),
        ("lwr.joint_accelerations", "udp.values0 * deg / s", "udp.values0 * deg / s is an angular "
         "velocity (rad/s), but lwr.joint_accelerations takes an angular acceleration (rad/s2)"),
        ("lwr.torques", "leader.joint_angles", "leader.joint_angles is an angle (rad), but "
         "lwr.torques takes a torque (Nm)"),
        ("lwr.torques", "leader.joint_angles * (20 * Nm / rad)", ""),
        ("lwr.billboard_values", "leader.joint_angles", ""),
        ("lwr.show_arrows", "udp.values0[1] * mm", ""),
        ("push.vector", "other.vectors0[0] * kN", ""),
        ("push.vector", "udp.values2 * mm / s", "udp.values2 * mm / s is a velocity (m/s), but "
         "push.vector takes a force (N)"),
        ("lwr.base_frame", "udp.matrices0[1]", ""),
        ("lwr.base_frame", "udp.matrices0", "udp.matrices0 is 2 x 4 x 4, but "
         "lwr.base_frame takes a 4 x 4 frame, 1M in the structure, or 7 numbers "
         "x, y, z, qw, qx, qy, qz"),
        ("lwr.torques", "udp.values0[0]", "udp.values0[0] has 1 value, but "
         "lwr.torques takes 2, one per joint"),
        ("lwr.torques", 0.5, ""),
        ("lwr.torques", [0.5, 1], ""),
        ("lwr.torques", np.array([0.5, 1.0]), ""),
        ("lwr.torques", [0.5], "[0.5] has 1 value, but lwr.torques takes 2, one per joint"),
        ("lwr.show_arrows", "not udp.values0",
         "udp.values0 has 2 values, but lwr.show_arrows takes 1 number"),
        ("lwr.torques", "not udp.values0", "'not' is only for toggles, but "
         "lwr.torques takes 2, one per joint"),
        ("lwr.torques", "udp.values0-udp.values1", "no event 'values0-udp.values1' of udp; "
         "write spaces around '-'"),
        ("lwr.torques", "udp.values0/2", "no frame 'udp.values0/2'; write spaces around '/'"),
        ("lwr.torques", "leader.torques/2 + 1", "no frame 'leader.torques/2'; "
         "write spaces around '/'"),
        ("lwr.torques", "deg/2 + 1", "no frame 'deg/2'; write spaces around '/'"),
        ("lwr.torques", "lwr/flang + 1", "no frame 'lwr/flang'; did you mean 'lwr/flange'?"),
        ("lwr.torques", "degg", "no unit 'degg'; did you mean 'deg'?"),
        ("lwr.torques", "leader.torque", "no output 'torque' of leader; did you mean 'torques'?"),
        ("push.vector", "push.vektor + 1", "no output 'vektor' of push; did you mean 'vector'?"),
        ("lwr.torques", "ledaer.torques", "no source or robot 'ledaer'; did you mean 'leader'?"),
        ("lwr.torques", "2 * udp.values0 * Mn", "no unit 'Mn'; did you mean 'mN'?"),
        ("lwr.torques", "2 * lwr/flange", "lwr/flange is a 4 x 4 frame, which cannot be "
         "indexed or combined"),
        ("lwr.torques", "lwr.fwd_kin_base_to_flange + 1",
         "lwr.fwd_kin_base_to_flange is a 4 x 4 frame, which cannot be indexed or combined"),
        ("lwr.torques", "udp.values0 *", "'udp.values0 *', character 14: found the end, expected "
         "an event such as udp.values0, a number, ( or ["),
    ],
)  # fmt: skip
def test_shapes_and_units_are_checked_when_a_scene_is_read(
    target: str, origin: Any, message: str
) -> None:
    assert messages({target: origin}) == ([message] if message else [])


def test_every_unknown_name_of_an_expression_is_reported() -> None:
    found = messages({"lwr.torques": "upd.values0 + udp.values9 * degg"})
    assert [text.partition(";")[0] for text in found] == [
        "no source 'upd'", "no event 'values9' of udp", "no unit 'degg'"
    ]  # fmt: skip


def test_source_takes_precedence_over_a_robot_of_the_same_name() -> None:
    sources = {"leader": {"kind": "udp", "structure": "2F"}}
    assert messages({"lwr.torques": "leader.values0 * 2"}, sources=sources) == []
    assert messages({"lwr.torques": "leader.torques * 2"}, sources=sources) == [
        "no event 'torques' of leader; available: receive_trigger, receiving, values0"
    ]


@pytest.mark.parametrize(
    ("routes", "circle"),
    [
        ({"lwr.torques": "lwr.torques + 1"}, "lwr.torques -> lwr.torques"),
        (
            {
                "lwr.joint_angles": "leader.joint_angles",
                "leader.joint_angles": "udp.values0 - goal.joint_angles",
                "goal.joint_angles": "lwr.joint_angles * 2",
            },
            "goal.joint_angles -> lwr.joint_angles -> leader.joint_angles -> goal.joint_angles",
        ),
    ],
)
def test_cycles_are_reported(routes: dict[str, str], circle: str) -> None:
    (found,) = messages(routes)
    assert found == f"values that depend on each other: {circle}"


def test_cycles_of_values_and_frames_are_reported_together() -> None:
    routes = {
        "lwr.torques": "lwr.torques",
        "lwr.base_frame": "leader/flange",
        "leader.base_frame": "lwr/flange",
    }
    assert [text.partition(":")[0] for text in messages(routes)] == [
        "values that depend on each other",
        "frames that depend on each other",
    ]


WORDS = ["udp.values0", "udp.values2", "other.vectors0", "udp.matrices0", "leader.torques"]
WORDS += ["lwr/flange", "lwr.fwd_kin_base_to_flange", "deg", "not", *"+-*/()[],:", "0", "1", "2"]


@settings(deadline=None)
@given(
    st.sampled_from(sorted(list_inputs(scene_of({})))),
    st.lists(st.sampled_from(WORDS), max_size=9).map(" ".join),
)
def test_any_text_is_a_route_or_a_problem(target: str, origin: str) -> None:
    wiring = wire(scene_of({target: origin}))
    made = len(wiring.routes) + len(wiring.frame_routes)
    in_circles = [problem for problem in wiring.problems if "follow each other" in problem.message]
    assert made + bool(wiring.problems) - len(in_circles) == 1
