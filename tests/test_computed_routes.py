"""Routes that compute: their shapes and units, several sources, outputs of other robots."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sero_mj.assemble.cartesian import SmartArrow
from sero_mj.assemble.double import Double
from sero_mj.assemble.frames import frame_from
from sero_mj.assemble.robot import SerialRobot
from sero_mj.assemble.scene import Scene
from sero_mj.assemble.world import World
from sero_mj.drive.place import Placer
from sero_mj.drive.route import wire
from sero_mj.drive.router import Router
from sero_mj.receive.source import Packet
from sero_mj.receive.udp import UdpReceiver

Array = NDArray[np.float64]
TWO = {
    "udp": {"kind": "udp", "structure": "2F2F3F2M"},
    "other": {"kind": "udp", "structure": "2F1V"},
}


def arm(name: str, types: list[str] | None = None, **fields: Any) -> SerialRobot:
    rows = [[0.0, 0.0, 0.0, 0.3], [1.5, 0.2, 0.0, 0.0]]
    return SerialRobot(
        name=name, dh_convention="craig", dh_params=rows, joint_types=types, **fields
    )


def scene_of(routes: Mapping[str, Any], **fields: Any) -> Scene:
    robots = [arm("lwr"), arm("leader", joint_angles=[0.3, -0.4]), arm("crane", ["prismatic"] * 2)]
    robots.append(arm("mixed", ["revolute", "prismatic"]))
    declared: dict[str, Any] = {
        "robots": robots,
        "sources": TWO,
        "doubles": [Double(name="goal", of="lwr")],
        "arrows": [SmartArrow(name="push", kind="force", at="lwr/flange")],
        "floor": False,
    }
    return Scene(**{**declared, **fields}, routes=dict(routes))


def messages(routes: Mapping[str, Any], **fields: Any) -> list[str]:
    return [problem.message for problem in wire(scene_of(routes, **fields)).problems]


class Fed:
    """A world that gets packets by hand."""

    def __init__(self, routes: Mapping[str, Any], **fields: Any) -> None:
        scene = scene_of(routes, **fields)
        self.world, self.wiring = World(scene), wire(scene)
        assert self.wiring.problems == []
        self.data = self.world.make_data()
        self._placer = Placer(self.world, self.wiring)
        self._latest: dict[str, Mapping[str, Array]] = {}

    def feed(self, source: str, **values: Any) -> None:
        events = {name: np.zeros(s) for name, s in self.wiring.sources[source].events.items()}
        packet = {**events, **{name: np.asarray(v, float) for name, v in values.items()}}
        routes = [route for route in self.wiring.routes if route.direct == source]
        Router(self.world, routes).apply(Packet(packet, 0.0, 1), self.data)
        self._latest[source] = packet
        self.place()

    def place(self) -> None:
        self._placer.place(self.data, self._latest)

    def __getitem__(self, target: str) -> list[float]:
        robot = self.world.robots.get(target.removesuffix(".joint_angles"))
        if robot is not None:
            return self.data.qpos[robot.qpos].tolist()
        return self.data.userdata[self.world.slots[target]].tolist()

    def has(self, target: str) -> bool:
        return bool(self.data.userdata[self.world.flags[target]])


@pytest.mark.parametrize(
    ("target", "origin", "message"),
    [
        ("lwr.joint_angles", "udp.values2[1:]", ""),
        ("lwr.joint_angles", "udp.values2[0:1]", "udp.values2[0:1] has 1 value; "
         "lwr.joint_angles takes 2, one per joint"),
        ("lwr.joint_angles", "udp.values2 * deg", "udp.values2 * deg has 3 values; "
         "lwr.joint_angles takes 2, one per joint"),
        ("lwr.joint_angles", "udp.values0 * deg", ""),
        ("lwr.joint_angles", "udp.values0 * mm", "udp.values0 * mm is a length (m); "
         "lwr.joint_angles takes an angle (rad)"),
        ("crane.joint_angles", "udp.values0 * mm", ""),
        ("crane.joint_angles", "udp.values0 * deg", "udp.values0 * deg is an angle (rad); "
         "crane.joint_angles takes a length (m)"),
        ("mixed.joint_angles", "[udp.values0[0] * deg, udp.values0[1] * mm]", ""),
        ("mixed.joint_angles", "udp.values0 * deg", "udp.values0 * deg is an angle (rad); "
         "mixed.joint_angles takes a length (m) at number 1, counted from 0"),
        ("mixed.joint_angles", "lwr.joint_angles", "lwr.joint_angles is an angle (rad); "
         "mixed.joint_angles takes a length (m) at number 1, counted from 0"),
        ("mixed.joint_angles", "1 * deg", "1 * deg is an angle (rad); "
         "mixed.joint_angles takes a length (m) at number 1, counted from 0"),
        ("mixed.torques", "[udp.values0[0] * mNm, udp.values0[1] * kN]", ""),
        ("crane.torques", "udp.values0 * Nm", "udp.values0 * Nm is a torque (Nm); "
         "crane.torques takes a force (N)"),
        ("lwr.joint_accelerations", "udp.values0 * deg / s / s", ""),
        ("lwr.joint_accelerations", "udp.values0 * deg / s", "udp.values0 * deg / s is an angular "
         "velocity (rad/s); lwr.joint_accelerations takes an angular acceleration (rad/s2)"),
        ("lwr.torques", "leader.joint_angles", "leader.joint_angles is an angle (rad); "
         "lwr.torques takes a torque (Nm)"),
        ("lwr.torques", "leader.joint_angles * (20 * Nm / rad)", ""),
        ("lwr.billboard_values", "leader.joint_angles", ""),
        ("lwr.show_arrows", "udp.values0[1] * mm", ""),
        ("push.vector", "other.vectors0[0] * kN", ""),
        ("push.vector", "udp.values2 * mm / s", "udp.values2 * mm / s is a velocity (m/s); "
         "push.vector takes a force (N)"),
        ("lwr.base_frame", "udp.matrices0[1]", ""),
        ("lwr.base_frame", "udp.matrices0", "udp.matrices0 is 2 x 4 x 4; "
         "lwr.base_frame takes a 4 x 4 frame: 1M in the structure"),
        ("lwr.torques", "udp.values0[0]", "udp.values0[0] has 1 value; "
         "lwr.torques takes 2, one per joint"),
        ("lwr.torques", 0.5, ""),
        ("lwr.torques", [0.5, 1], ""),
        ("lwr.torques", np.array([0.5, 1.0]), ""),
        ("lwr.torques", [0.5], "[0.5] has 1 value; lwr.torques takes 2, one per joint"),
        ("lwr.show_arrows", "not udp.values0", "udp.values0 has 2 values; lwr.show_arrows takes 1"),
        ("lwr.torques", "not udp.values0", "'not' is for switches; "
         "lwr.torques takes 2, one per joint"),
        ("lwr.torques", "udp.values0-udp.values1", "no event 'values0-udp.values1' of udp; "
         "put spaces about '-'"),
        ("lwr.torques", "udp.values0/2", "no frame 'udp.values0/2'; put spaces about '/'"),
        ("lwr.torques", "leader.torques/2 + 1", "no output 'torques/2' of leader; "
         "put spaces about '/'"),
        ("lwr.torques", "deg/2 + 1", "no frame 'deg/2'; put spaces about '/'"),
        ("lwr.torques", "lwr/flang + 1", "no frame 'lwr/flang'; did you mean 'lwr/flange'?"),
        ("lwr.torques", "degg", "no unit 'degg'; did you mean 'deg'?"),
        ("lwr.torques", "leader.torque", "no output 'torque' of leader; did you mean 'torques'?"),
        ("push.vector", "push.vektor + 1", "no output 'vektor' of push; did you mean 'vector'?"),
        ("lwr.torques", "ledaer.torques", "no source or robot 'ledaer'; did you mean 'leader'?"),
        ("lwr.torques", "2 * udp.values0 * Mn", "no unit 'Mn'; did you mean 'mN'?"),
        ("lwr.torques", "2 * lwr/flange", "lwr/flange is a 4 x 4 frame, which only goes whole"),
        ("lwr.torques", "lwr.fwd_kin_base_to_flange + 1",
         "lwr.fwd_kin_base_to_flange is a 4 x 4 frame, which only goes whole"),
        ("lwr.torques", "udp.values0 *", "'udp.values0 *', character 14: found the end, expected "
         "an event such as udp.values0, a number, ( or ["),
    ],
)  # fmt: skip
def test_shape_and_unit_are_checked_when_the_scene_is_read(
    target: str, origin: Any, message: str
) -> None:
    assert messages({target: origin}) == ([message] if message else [])


def test_every_wrong_name_of_an_expression_is_told() -> None:
    found = messages({"lwr.torques": "upd.values0 + udp.values9 * degg"})
    assert [text.partition(";")[0] for text in found] == [
        "no source 'upd'", "no event 'values9' of udp", "no unit 'degg'"
    ]  # fmt: skip


def test_a_source_is_meant_where_a_robot_has_the_same_name() -> None:
    sources = {"leader": {"kind": "udp", "structure": "2F"}}
    assert messages({"lwr.torques": "leader.values0 * 2"}, sources=sources) == []
    assert messages({"lwr.torques": "leader.torques * 2"}, sources=sources) == [
        "no event 'torques' of leader; available: values0"
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
def test_circles_are_told(routes: dict[str, str], circle: str) -> None:
    (found,) = messages(routes)
    assert found == f"values that follow each other: {circle}"


def test_a_packet_is_computed_with() -> None:
    fed = Fed({
        "lwr.joint_angles": "udp.values0[::-1] * deg",
        "lwr.torques": "udp.values0 - udp.values1",
        "goal.joint_angles": "[udp.values2[2], 0.5]",
        "lwr.show_arrows": "not udp.values2[0]",
        "lwr.billboard_values": [7, 8],
        "leader.joint_angles": "10 * deg",
    })  # fmt: skip
    fed.feed("udp", values0=[30.0, -90.0], values1=[1.0, 2.0], values2=[1.0, 5.0, 0.25])
    np.testing.assert_allclose(fed["lwr.joint_angles"], np.deg2rad([-90, 30]), rtol=1e-15)
    assert fed["lwr.torques"] == [29.0, -92.0]
    assert fed["goal.joint_angles"] == [0.25, 0.5]
    assert fed["lwr.show_arrows"] == [0.0]
    assert fed["lwr.billboard_values"] == [7.0, 8.0]
    np.testing.assert_allclose(fed["leader.joint_angles"], np.deg2rad([10, 10]), rtol=1e-15)
    targets = [route.to.target for route in fed.wiring.routes]
    assert all(fed.has(target) for target in targets)


def test_one_of_several_matrices_places_a_base() -> None:
    fed = Fed({"lwr.base_frame": "udp.matrices0[1]"})
    T = frame_from({"xyz": [0.1, 0.2, 0.3], "rpy": [0.3, -0.2, 1.0]}, np.asarray)
    fed.feed("udp", matrices0=[np.eye(4), T])
    np.testing.assert_allclose(fed.world.frame(fed.data, "lwr/base"), T, atol=1e-12)


def test_two_sources_are_computed_with_when_both_have_sent() -> None:
    fed = Fed({"lwr.torques": "udp.values0 - other.values0"})
    fed.feed("udp", values0=[5.0, 6.0])
    assert not fed.has("lwr.torques")
    fed.feed("other", values0=[1.0, 2.0])
    assert (fed.has("lwr.torques"), fed["lwr.torques"]) == (True, [4.0, 4.0])
    fed.feed("udp", values0=[0.0, 0.0])
    assert fed["lwr.torques"] == [-1.0, -2.0]


def test_robots_follow_robots_in_one_tick_whatever_the_order() -> None:
    fed = Fed({
        "mixed.billboard_values": "goal.joint_angles - lwr.joint_angles",
        "goal.joint_angles": "lwr.joint_angles + leader.joint_angles",
        "lwr.joint_angles": "leader.joint_angles * 0.5",
        "lwr.billboard_values": "lwr.commanded_torques - lwr.torques",
        "lwr.commanded_torques": "udp.values1",
        "lwr.torques": "udp.values0",
        "push.vector": "[lwr.torques / m, 0]",
    })  # fmt: skip
    fed.place()
    assert fed["lwr.joint_angles"] == [0.15, -0.2]
    np.testing.assert_allclose(fed["goal.joint_angles"], [0.45, -0.6], rtol=1e-15)
    np.testing.assert_allclose(fed["mixed.billboard_values"], [0.3, -0.4], rtol=1e-15)
    # Nothing has come, so there is nothing to compute with.
    assert not fed.has("lwr.billboard_values") and not fed.has("push.vector")
    fed.feed("udp", values0=[1.0, 2.0], values1=[1.5, 1.0])
    assert fed["lwr.billboard_values"] == [0.5, -1.0]
    assert fed["push.vector"] == [1.0, 2.0, 0.0]
    fed.world.set_input(fed.data, "leader.joint_angles", [1.0, 1.0])
    fed.place()
    assert fed["lwr.joint_angles"] == [0.5, 0.5]
    flange = fed.world.fwd_kin_base_to_flange(fed.data, "lwr")
    robot = fed.world.scene.robots["lwr"]
    np.testing.assert_allclose(flange, robot.fwd_kin_base_to_flange(np.array([0.5, 0.5])))


def test_a_double_that_is_nowhere_leads_nobody() -> None:
    fed = Fed({"lwr.joint_angles": "goal.joint_angles", "goal.joint_angles": "udp.values0"})
    fed.place()
    assert fed["lwr.joint_angles"] == [0.0, 0.0] and not fed.has("lwr.joint_angles")
    fed.feed("udp", values0=[0.5, 0.25])
    assert fed["lwr.joint_angles"] == [0.5, 0.25]
    doubles = [Double(name="goal", of="lwr", joint_angles=[0.1, 0.2])]
    declared = Fed({"lwr.joint_angles": "goal.joint_angles"}, doubles=doubles)
    declared.place()
    assert declared["lwr.joint_angles"] == [0.1, 0.2]


def test_nan_goes_where_it_moves_nothing_not_even_in_the_end() -> None:
    def allowed(routes: dict[str, str]) -> set[str]:
        asked: list[set[str]] = []
        source = UdpReceiver(name="udp", structure="2F2F")
        scene = scene_of(routes, sources={"udp": source})
        object.__setattr__(source, "allow_nan", lambda events: asked.append(set(events)))
        assert wire(scene).problems == []
        return asked[-1]

    assert allowed({"lwr.torques": "udp.values0 * 2 - udp.values1"}) == {"values0", "values1"}
    routes = {"lwr.torques": "udp.values0 * 2", "lwr.joint_angles": "udp.values0 + udp.values1"}
    assert allowed(routes) == set()
    routes = {
        "lwr.billboard_values": "udp.values0",
        "leader.billboard_values": "lwr.billboard_values * 2",
        "mixed.joint_angles": "leader.billboard_values",
        "mixed.torques": "udp.values1",
    }
    assert allowed(routes) == {"values1"}


def test_nan_blanks_the_number_that_is_computed_from_it() -> None:
    fed = Fed({"lwr.torques": "udp.values0 * 2 - udp.values1", "leader.torques": "2 * lwr.torques"})
    fed.feed("udp", values0=[math.nan, 2.0], values1=[1.0, 1.0])
    np.testing.assert_equal(fed["lwr.torques"], [math.nan, 3.0])
    np.testing.assert_equal(fed["leader.torques"], [math.nan, 6.0])


def test_what_overflows_blanks_and_moves_nothing() -> None:
    fed = Fed({"lwr.torques": "udp.values0 * 1e10", "lwr.joint_angles": "udp.values0 * 1e10"})
    fed.feed("udp", values0=[1.0, 2e-10])
    fed.feed("udp", values0=[1e300, 1.0])
    np.testing.assert_equal(fed["lwr.torques"], [math.nan, 1e10])
    assert fed["lwr.joint_angles"] == [1e10, 2.0]
