"""Route expressions: with one packet, with several, and with outputs of other robots."""

from __future__ import annotations

import math
import socket
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from newton_euler import inverse_dynamics
from numpy.typing import NDArray
from polling import until
from route_scenes import arm, scene_of

from sero_mj.base.frames import frame_from
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.drive.place import Placer, Router
from sero_mj.data.drive.wiring import wire
from sero_mj.data.receive.udp import UdpReceiver
from sero_mj.data.send.play import MotionPackets
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.double import Double
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.viewer.decor.staleness import NO_DATA_YET, Staleness

Array = NDArray[np.float64]


class Fed:
    """A world whose packets are fed by the test."""

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
        Router(self.world, routes).apply(self.data, {source: packet})
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


def test_expressions_compute_with_one_packet() -> None:
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


@pytest.mark.parametrize(
    ("condition", "holds"),
    [
        ("udp.values2[0] == 2", True),
        ("udp.values2[0] != 2", False),
        ("udp.values0 > 25", True),  # for any of them
        ("udp.values0 > 25 and udp.values0 < 29", False),  # of the same one
        ("0 <= udp.values1 - udp.values0 < 100", True),
        ("not udp.values2[0] == 2 or udp.values2[1] >= 5", True),
        ("not (udp.values2[0] == 2 and udp.values2[1] >= 5)", False),
        ("udp.values0[0] * deg > 0.5 * rad", True),
        ("abs(udp.values0[1]) > 89", True),  # functions, as in triggers
        ("norm(udp.values2) < 5.3 or max(udp.values0) > 30", False),
        ("all(abs(udp.values0 - udp.values1) > 28)", True),
        ("any(udp.values0 < -90)", False),
        ("udp.values0[0] * udp.values0[1] < min([udp.values2, 0])", True),
        ("udp.receiving == 1", None),
    ],
)
def test_condition_switches_a_flag(condition: str, holds: bool | None) -> None:
    fed = Fed({"lwr.show_arrows": condition})
    if holds is None:  # needs more than one packet
        assert [route.direct for route in fed.wiring.routes] == [None]
        return
    fed.feed("udp", values0=[30.0, -90.0], values1=[1.0, 2.0], values2=[2.0, 5.0, 0.25])
    assert fed["lwr.show_arrows"] == [float(holds)]
    fed.feed("udp", values0=[np.nan] * 2, values1=[np.nan] * 2, values2=[np.nan] * 3)
    assert np.isnan(fed["lwr.show_arrows"]).all()  # no data, as for any flag


@pytest.mark.parametrize(
    ("target", "condition", "expected"),
    [
        (
            "lwr.torques",
            "udp.values0 > 1",
            "comparisons are only for toggles, but lwr.torques takes 2, one",
        ),
        ("lwr.show_arrows", "udp.values0 > 1 and udp.values1", "expected a comparison such as"),
        (
            "lwr.show_arrows",
            "(udp.values0 > 1) + 1 > 0",
            "expected numbers; combine comparisons with 'and' or 'or'",
        ),
        ("lwr.show_arrows", "udp.values0 = 1", "between spaces, or the end; write == to compare"),
        ("lwr.show_arrows", "udp.values0 > udp.values2", "found 2 values and 3 values"),
        ("lwr.show_arrows", "abs(udp.values0)", "only toggles take functions and comparisons"),
        ("lwr.torques", "abs(udp.values0)", "only toggles take functions and comparisons"),
        ("lwr.show_arrows", "abs(udp.values0, 2) > 1", "expected a function with one argument"),
        ("lwr.show_arrows", "aps(udp.values0) > 1", "expected a function; did you mean 'abs'?"),
        ("lwr.show_arrows", "2 * deg > 1 * mm", "found an angle (rad) and a length (m)"),
        (
            "lwr.show_arrows",
            "udp.values0 > 1 or udp.values2 > 1",
            "found 'or', expected equal sizes on both sides; found 2 values and 3 values",
        ),
    ],
)
def test_invalid_conditions_are_rejected(target: str, condition: str, expected: str) -> None:
    (problem,) = wire(scene_of({target: condition})).problems
    assert problem.key == f"routes.{target}"
    assert expected in problem.message


def test_one_of_several_matrices_places_a_base() -> None:
    fed = Fed({"lwr.base_frame": "udp.matrices0[1]"})
    T = frame_from({"xyz": [0.1, 0.2, 0.3], "rpy": [0.3, -0.2, 1.0]}, np.asarray)
    fed.feed("udp", matrices0=[np.eye(4), T])
    np.testing.assert_allclose(fed.world.frame(fed.data, "lwr/base"), T, atol=1e-12)


@pytest.mark.parametrize("times", ["* mm", "* 0.001", "/ 1000", "* 2 * mm / 2"])
def test_position_of_a_matrix_can_have_another_unit(times: str) -> None:
    fed = Fed({
        "lwr.base_frame": f"udp.matrices0[1] {times}",
        "lwr.flange_check": f"udp.matrices0[0] {times}",
        "leader.base_frame": "0.001 * udp.matrices0[1]",
    })  # fmt: skip
    T = frame_from({"xyz": [0.1, 0.2, 0.3], "rpy": [0.3, -0.2, 1.0]}, np.asarray)
    in_mm = T.copy()
    in_mm[:3, 3] *= 1000.0
    fed.feed("udp", matrices0=[in_mm, in_mm])
    np.testing.assert_allclose(fed.world.frame(fed.data, "lwr/base"), T, atol=1e-12)
    np.testing.assert_allclose(fed.world.frame(fed.data, "leader/base"), T, atol=1e-12)
    np.testing.assert_allclose(fed["lwr.flange_check"], T.ravel(), atol=1e-12)


def test_expression_of_two_sources_is_computed_once_both_have_sent() -> None:
    fed = Fed({"lwr.torques": "udp.values0 - other.values0"})
    fed.feed("udp", values0=[5.0, 6.0])
    assert not fed.has("lwr.torques")
    fed.feed("other", values0=[1.0, 2.0])
    assert (fed.has("lwr.torques"), fed["lwr.torques"]) == (True, [4.0, 4.0])
    fed.feed("udp", values0=[0.0, 0.0])
    assert fed["lwr.torques"] == [-1.0, -2.0]


def test_robots_follow_robots_in_one_tick_in_any_order() -> None:
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
    # Nothing was received, so there is nothing to compute with.
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


def test_double_without_data_does_not_move_its_follower() -> None:
    fed = Fed({"lwr.joint_angles": "goal.joint_angles", "goal.joint_angles": "udp.values0"})
    fed.place()
    assert fed["lwr.joint_angles"] == [0.0, 0.0] and not fed.has("lwr.joint_angles")
    fed.feed("udp", values0=[0.5, 0.25])
    assert fed["lwr.joint_angles"] == [0.5, 0.25]
    doubles = [Double(name="goal", of="lwr", joint_angles=[0.1, 0.2])]
    declared = Fed({"lwr.joint_angles": "goal.joint_angles"}, doubles=doubles)
    declared.place()
    assert declared["lwr.joint_angles"] == [0.1, 0.2]


def test_nan_is_allowed_only_where_it_moves_nothing() -> None:
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


def test_nan_blanks_the_value_computed_from_it() -> None:
    fed = Fed({"lwr.torques": "udp.values0 * 2 - udp.values1", "leader.torques": "2 * lwr.torques"})
    fed.feed("udp", values0=[math.nan, 2.0], values1=[1.0, 1.0])
    np.testing.assert_equal(fed["lwr.torques"], [math.nan, 3.0])
    np.testing.assert_equal(fed["leader.torques"], [math.nan, 6.0])


def test_overflow_blanks_the_value_and_moves_nothing() -> None:
    fed = Fed({"lwr.torques": "udp.values0 * 1e10", "lwr.joint_angles": "udp.values0 * 1e10"})
    fed.feed("udp", values0=[1.0, 2e-10])
    fed.feed("udp", values0=[1e300, 1.0])
    np.testing.assert_equal(fed["lwr.torques"], [math.nan, 1e10])
    assert fed["lwr.joint_angles"] == [1e10, 2.0]


def test_follower_is_as_stale_as_its_leader() -> None:
    scene = scene_of({
        "leader.joint_angles": "udp.values0",
        "lwr.torques": "other.values0 - udp.values1",
        "lwr.joint_angles": "leader.joint_angles * 0.5",
        "crane.billboard_values": "lwr.torques * (1 / Nm)",
        "mixed.torques": [1, 2],
    })  # fmt: skip
    assert scene.sources_of("lwr.joint_angles") == {"udp"}
    assert scene.sources_of("lwr.torques") == {"udp", "other"}
    assert scene.sources_of("crane.billboard_values") == {"udp", "other"}
    assert scene.sources_of("mixed.torques") == set()
    assert scene.sources_of() == {"udp", "other"}
    scene.routes["lwr.torques"] = "crane.billboard_values"  # another test covers cycles
    assert scene.sources_of("lwr.torques") == set()


def test_mirror_computes_with_packets_of_two_sources() -> None:
    robots = [arm("lwr"), arm("leader"), arm("free")]
    routes = {
        "leader.joint_angles": "udp.values0 * deg",
        "lwr.joint_angles": "leader.joint_angles[::-1]",
        "lwr.torques": "other.values0 - udp.values1",
    }
    sources = {name: {"kind": "udp", "structure": "2F2F"} for name in ("udp", "other")}
    scene = Scene(robots=robots, sources=sources, routes=routes, floor=False)
    with Mirror(scene) as mirror, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        staleness, world, data = Staleness(mirror.world), mirror.world, mirror.data

        def send(name: str, *values: float) -> None:
            source = mirror.sources[name]
            assert isinstance(source, UdpReceiver)
            sock.sendto(struct.pack("<4d", *values), ("127.0.0.1", source.port))
            assert until(mirror.advance)

        mirror.advance()
        assert staleness.find(data) == {"lwr": NO_DATA_YET, "leader": NO_DATA_YET}
        send("udp", 90.0, -45.0, 1.0, 2.0)
        np.testing.assert_allclose(data.qpos[world.robots["lwr"].qpos], np.deg2rad([-45, 90]))
        assert staleness.find(data) == {"lwr": NO_DATA_YET}
        assert data.userdata[world.flags["lwr.torques"]] == 0.0
        send("other", 5.0, 5.0, 0.0, 0.0)
        assert data.userdata[world.slots["lwr.torques"]].tolist() == [4.0, 3.0]
        assert staleness.find(data) == {}
        mirror.reset()
        assert data.userdata[world.flags["lwr.torques"]] == 0.0
        assert mirror.advance()
        assert data.userdata[world.slots["lwr.torques"]].tolist() == [4.0, 3.0]


# ---- outputs of models

ANGLES = np.array([0.2, 0.6, -0.3, -1.2, 0.4, 0.8, 0.1])
MODELLED = {
    "robots": [SerialRobot.from_model("lwr", name="lwr", inputs=["joint_velocities"])],
    "sources": {"udp": {"kind": "udp", "structure": "7F7F7F"}},
    "doubles": [],
    "arrows": [],
}


def weight(angles: Array, **of_robot: Any) -> Array:
    robot = SerialRobot.from_model("lwr", **of_robot)
    return inverse_dynamics(robot, robot_dynamics(robot), angles)


def test_route_reads_gravity_torques() -> None:
    fed = Fed(
        {
            "lwr.joint_angles": "udp.values0",
            "lwr.torques": "udp.values1 - lwr.gravity_torques",
            "lwr.billboard_values": "lwr.gravity_torques * 1",
            "lwr.commanded_torques": "2 * lwr.torques[0:7] + 0 * Nm",
        },
        **MODELLED,
    )
    for angles in (ANGLES, -ANGLES, np.zeros(7)):
        fed.feed("udp", values0=angles, values1=np.full(7, 5.0))
        assert fed["lwr.billboard_values"] == pytest.approx(weight(angles), abs=1e-6)
        assert fed["lwr.torques"] == pytest.approx(5.0 - weight(angles), abs=1e-6)
        assert fed["lwr.commanded_torques"] == pytest.approx(10.0 - 2 * weight(angles), abs=1e-6)


def test_gravity_torques_use_angles_set_by_another_route() -> None:
    robots = [SerialRobot.from_model("lwr", name=name) for name in ("one", "two")]
    fed = Fed(
        {
            "two.billboard_values": "two.gravity_torques",
            "two.joint_angles": "-1 * one.joint_angles",
            "one.joint_angles": "udp.values0",
        },
        **{**MODELLED, "robots": robots},
    )
    fed.feed("udp", values0=ANGLES)
    assert fed["two.billboard_values"] == pytest.approx(weight(-ANGLES), abs=1e-6)


def test_gravity_torques_include_mounted_robots() -> None:
    below = SerialRobot.from_model("lwr", name="below")
    above = SerialRobot.from_model("lwr", name="above", mount="below/flange")
    routes = {"below.billboard_values": "below.gravity_torques",
              "below.joint_angles": "udp.values0"}  # fmt: skip
    fed = Fed(routes, **{**MODELLED, "robots": [below, above]})
    fed.feed("udp", values0=ANGLES)
    assert abs(fed["below.billboard_values"][1]) > 1.5 * abs(weight(ANGLES)[1])


def test_route_reads_friction_torques() -> None:
    robot = MODELLED["robots"][0]
    fed = Fed(
        {
            "lwr.joint_angles": "udp.values0",
            "lwr.joint_velocities": "udp.values2 * deg / s",
            "lwr.torques": "udp.values1 - lwr.friction_torques",
        },
        **MODELLED,
    )
    speeds = np.array([30.0, -60.0, 2.0, -90.0, 10.0, -5.0, 180.0])
    fed.feed("udp", values1=np.ones(7), values2=speeds)
    dynamics = robot.dynamics
    expected = dynamics.viscous_friction * np.deg2rad(speeds)
    expected += dynamics.coulomb_friction * np.sign(speeds)
    assert fed["lwr.torques"] == pytest.approx(1.0 - expected, abs=1e-9)


def test_declared_input_takes_precedence_over_the_model_output() -> None:
    robot = SerialRobot.from_model("lwr", name="lwr", inputs=["gravity_torques"])
    routes = {"lwr.gravity_torques": "udp.values1",
              "lwr.billboard_values": "lwr.gravity_torques"}  # fmt: skip
    fed = Fed(routes, **{**MODELLED, "robots": [robot]})
    fed.feed("udp", values1=ANGLES)
    assert fed["lwr.billboard_values"] == ANGLES.tolist()


def test_mirror_derives_velocities_for_friction() -> None:
    scene = scene_of(
        {"lwr.joint_angles": "udp.values0", "lwr.billboard_values": "lwr.friction_torques"},
        **MODELLED,
    )
    dynamics = MODELLED["robots"][0].dynamics
    with Mirror(scene) as mirror:
        for time in (1.0, 1.02):
            packet = struct.pack("<21d", *[0.5 * time] * 7, *[0.0] * 14)
            mirror.sources["udp"].accept([packet], [time])
            mirror.advance()
        found = mirror.data.userdata[mirror.world.slots["lwr.billboard_values"]]
        assert found == pytest.approx(0.5 * dynamics.viscous_friction + dynamics.coulomb_friction)


@pytest.mark.parametrize(
    ("routes", "fields", "message"),
    [
        ({"fr3.torques": "fr3.friction_torques"}, {},
         "no output 'friction_torques' of fr3: dynamics has neither viscous_friction nor "
         "coulomb_friction"),
        ({"fr3.torques": "fr3.gravity_torques"}, {"free_base": True},
         "no output 'gravity_torques' of fr3: the base of fr3 is free, so no torques hold it"),
        ({"fr3.torques": "fr3.gravity_torque"}, {},
         "no output 'gravity_torque' of fr3; did you mean 'gravity_torques'?"),
        ({"fr3.joint_angles": "fr3.gravity_torques"}, {},
         "fr3.gravity_torques is a torque (Nm), but fr3.joint_angles takes an angle (rad)"),
        ({"fr3.torques": "udp.values0 * deg - fr3.gravity_torques"}, {},
         "expected the same unit on both sides; found an angle (rad) and a torque (Nm)"),
        ({"fr3.joint_angles": "0.1 * fr3.billboard_values",
          "fr3.billboard_values": "fr3.gravity_torques"}, {},
         "values that depend on each other: fr3.billboard_values -> fr3.joint_angles -> "
         "fr3.billboard_values"),
    ],
)  # fmt: skip
def test_missing_model_data_is_reported(
    routes: Mapping[str, Any], fields: Mapping[str, Any], message: str
) -> None:
    robots = [SerialRobot.from_model("fr3", name="fr3", **fields)]
    problems = wire(scene_of(routes, **{**MODELLED, "robots": robots})).problems
    (found,) = [problem.message for problem in problems]
    assert message in found.replace("\n", " ")


def test_sent_torques_route_back_to_the_shown_ones() -> None:
    scene = scene_of(
        {
            "lwr.joint_angles": "udp.values0",
            "lwr.joint_velocities": "udp.values2",
            "lwr.torques": "udp.values1 - lwr.gravity_torques - lwr.friction_torques",
        },
        **MODELLED,
    )
    packets = MotionPackets(scene)
    fed = Fed(scene.routes, **MODELLED)
    for time in (0.0, 0.7, 3.1):
        values = packets.structure.decode(packets.at(time))
        fed.feed("udp", **values)
        expected = packets._robots["lwr"].signals(time)["torques"]
        assert fed["lwr.torques"] == pytest.approx(expected, abs=1e-9)
