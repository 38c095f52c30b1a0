"""Playing a motion through route expressions: routing the sent packets returns the motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sero_mj.base.errors import UsageError
from sero_mj.data.drive.place import Placer, Router
from sero_mj.data.drive.wiring import wire
from sero_mj.data.receive.structure import are_frames
from sero_mj.data.send.motion import LEAD, InverseDynamics, SineMotion
from sero_mj.data.send.play import MotionPackets
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.cartesian import ReceivedFrame, SmartArrow
from sero_mj.robots.declared.double import Double
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene

Array = NDArray[np.float64]
T = 0.37


def arm(name: str, n: int = 3) -> SerialRobot:
    rows = [[0.0, 0.0, 0.0, 0.3], [1.5, 0.2, 0.0, 0.0], [0.3, 0.1, 0.2, 0.1]]
    return SerialRobot(name=name, dh_convention="craig", dh_params=rows[:n])


def scene_of(structure: str | dict[str, str], routes: dict[str, Any]) -> Scene:
    structures = {"udp": structure} if isinstance(structure, str) else structure
    return Scene(
        robots=[arm("lwr"), arm("leader")],
        doubles=[Double(name="goal", of="lwr")],
        arrows=[SmartArrow(name="push", kind="force", at="lwr/flange")],
        frames=[ReceivedFrame(name="target")],
        sources={name: {"kind": "udp", "structure": text} for name, text in structures.items()},
        routes=routes,
        floor=False,
    )


def received(scene: Scene, **structure: str) -> tuple[World, Any]:
    """A world after one packet of every source, made for time T."""
    world, wiring = World(scene), wire(scene)
    data = world.make_data()
    latest = {}
    for name, source in wiring.sources.items():
        packet = MotionPackets(scene, name, **structure).at(T)
        latest[name] = source.layout.decode(packet)  # type: ignore[attr-defined]
        routes = [route for route in wiring.routes if route.direct == name]
        Router(world, routes).apply(data, latest)
    Placer(world, wiring).place(data, latest)
    return world, data


def angles(world: World, data: Any, name: str) -> Array:
    return np.array(data.qpos[world.robots[name].qpos])


def shown(world: World, data: Any, target: str) -> Array:
    assert data.userdata[world.flags[target]]
    return np.array(data.userdata[world.slots[target]])


POSITION, VELOCITY, ACCELERATION = SineMotion(arm("lwr")).at(T)
COMMANDED = SineMotion(arm("lwr")).at(T + LEAD)[0]
TORQUES = InverseDynamics(arm("lwr")).torques(POSITION, VELOCITY, ACCELERATION)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("structure", "origin"),
    [
        ("3F", "udp.values0"),
        ("3F", "udp.values0 * deg"),
        ("9F", "udp.values0[3:6]"),
        ("9F", "udp.values0[::-4]"),
        ("3F", "-udp.values0[1,2,0] / 2 + [0.1, 0, -3]"),
        ("2F1F", "[udp.values1, udp.values0[1] * deg, 3 * udp.values0[0]]"),
        ("3F3F", "udp.values0 - udp.values1"),
        ("1V", "udp.vectors0 * mrad"),
        ("2V", "udp.vectors0[1]"),
    ],
)
def test_sent_packets_route_back_to_the_joint_angles(structure: str, origin: str) -> None:
    routes = {"lwr.joint_angles": origin}
    world, data = received(scene_of(structure, routes))
    np.testing.assert_allclose(angles(world, data, "lwr"), POSITION, atol=1e-13)


@pytest.mark.slow
def test_one_event_with_several_slices_carries_all_signals() -> None:
    routes = {
        "lwr.joint_angles": "udp.values0[0:3] * deg",
        "lwr.torques": "udp.values0[3:6] * mNm",
        "lwr.commanded_torques": "udp.values0[6:9] + udp.values0[3:6] * mNm",
        "goal.joint_angles": "udp.values0[9:12] - 1",
        "push.vector": "udp.values0[12:15]",
        "lwr.show_arrows": "not udp.values0[15]",
        "target.frame": "udp.matrices0[1] * mm",
    }
    scene = scene_of("16F2M", routes)
    world, data = received(scene)
    np.testing.assert_allclose(angles(world, data, "lwr"), POSITION, atol=1e-12)
    np.testing.assert_allclose(shown(world, data, "lwr.torques"), TORQUES, atol=1e-12)
    np.testing.assert_allclose(shown(world, data, "lwr.commanded_torques"), TORQUES, atol=1e-12)
    np.testing.assert_allclose(shown(world, data, "goal.joint_angles"), COMMANDED, atol=1e-12)
    assert np.linalg.norm(shown(world, data, "push.vector")) > 1.0
    assert shown(world, data, "lwr.show_arrows").tolist() == [0.0]
    assert are_frames(shown(world, data, "target.frame").reshape(1, 4, 4)).all()
    # A matrix that no route uses is a valid frame, too. Otherwise the packet would be malformed.
    layout = wire(scene).sources["udp"].layout  # type: ignore[attr-defined]
    assert are_frames(layout.decode(MotionPackets(scene).at(T))["matrices0"]).all()


@pytest.mark.thorough
@pytest.mark.slow
def test_conflicting_routes_give_the_robot_its_motion() -> None:
    routes = {
        "lwr.billboard_values": "udp.values0",
        "goal.joint_angles": "udp.values0 * 2",
        "leader.joint_angles": "-udp.values0",
        "lwr.joint_angles": "udp.values0[::-1]",
    }
    world, data = received(scene_of("3F", routes))
    leader = SineMotion(arm("leader")).at(T)[0]
    np.testing.assert_allclose(angles(world, data, "leader"), leader, atol=1e-13)
    np.testing.assert_allclose(angles(world, data, "lwr"), -leader[::-1], atol=1e-13)
    plain = {"lwr.billboard_values": "udp.values0", "lwr.joint_angles": "udp.values0"}
    world, data = received(scene_of("3F", plain))
    assert (angles(world, data, "lwr") == POSITION).all()


def test_packets_of_two_senders_together_give_the_motion() -> None:
    routes = {
        "lwr.joint_angles": "udp.values0 - other.values0",
        "goal.joint_angles": "other.values0",
    }
    world, data = received(scene_of({"udp": "3F", "other": "3F"}, routes))
    np.testing.assert_allclose(angles(world, data, "lwr"), POSITION, atol=1e-13)
    np.testing.assert_allclose(shown(world, data, "goal.joint_angles"), COMMANDED, atol=1e-13)


@pytest.mark.thorough
@pytest.mark.slow
def test_routes_can_use_outputs_of_robots_beside_events() -> None:
    routes = {
        "leader.joint_angles": "udp.values0",
        "lwr.joint_angles": "leader.joint_angles * 0.5 + udp.values1",
        "goal.joint_angles": "udp.values2 + (leader.torques - lwr.torques) * rad / Nm",
        "leader.torques": [1, 2, 3],
    }
    world, data = received(scene_of("3F3F3F", routes))
    np.testing.assert_allclose(angles(world, data, "lwr"), POSITION, atol=1e-13)
    assert not data.userdata[world.flags["goal.joint_angles"]]  # lwr.torques are never received
    routes["goal.joint_angles"] = "udp.values2 + leader.torques * rad / Nm"
    world, data = received(scene_of("3F3F3F", routes))
    np.testing.assert_allclose(shown(world, data, "goal.joint_angles"), COMMANDED, atol=1e-13)


@pytest.mark.slow
def test_routes_can_use_outputs_of_a_robot_that_another_source_moves() -> None:
    routes = {
        "leader.joint_angles": "other.values0",
        "lwr.joint_angles": "leader.joint_angles * 0.5",
        "goal.joint_angles": "udp.values0 + lwr.joint_angles",
    }
    world, data = received(scene_of({"udp": "3F", "other": "3F"}, routes))
    np.testing.assert_allclose(shown(world, data, "goal.joint_angles"), COMMANDED, atol=1e-13)


def test_robot_that_follows_another_needs_no_packet() -> None:
    routes = {"leader.joint_angles": "udp.values0", "lwr.joint_angles": "leader.joint_angles"}
    world, data = received(scene_of("3F", routes))
    assert (angles(world, data, "lwr") == SineMotion(arm("leader")).at(T)[0]).all()


@pytest.mark.parametrize(
    ("origin", "structure", "message"),
    [
        ("udp.values0", "9F", "9 values, but lwr.joint_angles takes 3, one per joint"),
        ("udp.values0[6:9]", "8F", "8 values, but lwr.joint_angles is udp.values0[6:9]"),
    ],
)
def test_other_structure_without_the_routed_values_is_rejected(
    origin: str, structure: str, message: str
) -> None:
    scene = scene_of("9F" if "[" in origin else "3F", {"lwr.joint_angles": origin})
    with pytest.raises(UsageError) as caught:
        MotionPackets(scene, structure=structure)
    assert str(caught.value) == f"structure '{structure}': values0 has {message}"


def test_longer_structure_carries_the_routed_values() -> None:
    scene = scene_of("4F", {"lwr.joint_angles": "udp.values0[1:4]"})
    packets = MotionPackets(scene, structure="9F")
    values = packets.structure.decode(packets.at(T))["values0"]
    np.testing.assert_allclose(values, [0.0, *POSITION, 0, 0, 0, 0, 0], atol=1e-13)


@pytest.mark.thorough
def test_constants_and_types_of_the_structure_are_preserved() -> None:
    scene = scene_of("id: 1H=7, joints: 3h, 2M", {"lwr.joint_angles": "udp.joints * (0.1 * mrad)"})
    world, data = received(scene)
    np.testing.assert_allclose(angles(world, data, "lwr"), POSITION, atol=0.051e-3)
    assert MotionPackets(scene).at(T)[:2] == (7).to_bytes(2, "little")


def test_route_with_factor_zero_is_ignored() -> None:
    scene = scene_of("3F", {"lwr.joint_angles": "0 * udp.values0 + [1, 2, 3]"})
    world, data = received(scene)
    assert angles(world, data, "lwr").tolist() == [1.0, 2.0, 3.0]
