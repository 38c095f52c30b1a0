"""Bases, cameras, objects and received frames relative to frames, also from real packets."""

from __future__ import annotations

import socket
from pathlib import Path

import mujoco
import numpy as np
import pytest
from polling import until

from sero_mj.base.errors import DeclarationError
from sero_mj.base.frames import frame_from, inverse, quat_from_rotation
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.drive.place import Placer
from sero_mj.data.send.play import MotionPackets
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.cartesian import ReceivedFrame, SmartArrow
from sero_mj.robots.declared.double import Double
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.robots.declared.surroundings import Camera, Object
from sero_mj.viewer.decor.flange_check import flange_difference

Q = np.array([0.3, -0.7, 0.4, 1.2, -0.5, 0.8, 0.2])
BASE = {"xyz": [0.2, -0.3, 0.1], "rpy": [0.1, -0.2, 1.0]}


def frame(value: dict[str, list[float]]) -> np.ndarray:
    return frame_from(value, np.asarray)


def arm(name: str, **fields) -> SerialRobot:
    """Returns a robot with two joints, the second perpendicular to the first."""
    rows = [[0.0, 0.0, 0.0, 0.1], [1.5, 0.2, 0.0, 0.0]]
    return SerialRobot(name=name, dh_convention="craig", dh_params=rows, **fields)


def lwr(**fields) -> SerialRobot:
    return SerialRobot.from_model("lwr", base_frame=BASE, joint_angles=Q, **fields)


def T_world_flange(robot: SerialRobot, q: np.ndarray, base: np.ndarray) -> np.ndarray:
    """Returns the flange pose by NumPy alone."""
    return robot.dh.frames(q, base)[-1] @ robot.flange_frame


def placed(scene: Scene) -> tuple[World, mujoco.MjData]:
    world = World(scene)
    data = world.make_data()
    Placer(world).place(data)
    return world, data


def test_chain_of_robots_on_flanges_moves_in_one_tick() -> None:
    robots = [arm("third"), arm("second", joint_angles=[0.4, -0.3]), lwr()]
    routes = {"third.base_frame": "second/flange", "second.base_frame": "lwr/flange"}
    world, data = placed(Scene(robots=robots, routes=routes, floor=False))
    first = T_world_flange(robots[2], Q, robots[2].base_frame)
    second = T_world_flange(robots[1], np.array([0.4, -0.3]), first)
    third = T_world_flange(robots[0], np.zeros(2), second)
    np.testing.assert_allclose(world.frame(data, "second/base"), first, atol=1e-12)
    np.testing.assert_allclose(world.frame(data, "third/flange"), third, atol=1e-12)
    world.set_input(data, "lwr.joint_angles", Q + 0.2)
    Placer(world).place(data)
    moved = T_world_flange(robots[2], Q + 0.2, robots[2].base_frame)
    np.testing.assert_allclose(world.frame(data, "second/base"), moved, atol=1e-12)


def test_cameras_and_objects_move_with_their_frames() -> None:
    tool = Object(name="tcp", shape="axes", size=[0.1], frame={"xyz": [0, 0, 0.2]})
    robot = lwr(children=[tool])
    scene = Scene(
        robots=[robot],
        objects=[Object(name="ball", shape="sphere", size=[0.05])],
        cameras={"wrist": Camera(position=[0.1, 0.0, 0.0], look_at=[0.1, 0.0, 0.5])},
        routes={"ball.frame": "lwr/tcp", "wrist.frame": "lwr/link6"},
        floor=False,
    )
    _, data = placed(scene)
    flange = T_world_flange(robot, Q, robot.base_frame)
    np.testing.assert_allclose(data.geom("ball").xpos, (flange @ tool.frame)[:3, 3], atol=1e-12)
    link = robot.dh.frames(Q, robot.base_frame)[6]
    np.testing.assert_allclose(data.cam("wrist").xpos, (link @ [0.1, 0, 0, 1])[:3], atol=1e-12)
    # A camera looks along its -z axis.
    np.testing.assert_allclose(-data.cam("wrist").xmat.reshape(3, 3)[:, 2], link[:3, 2], atol=1e-9)


def test_doubles_and_received_frames_can_be_route_origins() -> None:
    target = Q + 0.5
    robots = [lwr(), arm("a"), arm("b"), arm("c")]
    T = frame({"xyz": [0.1, 0.2, 0.3], "rpy": [0.0, 0.5, 0.2]})
    scene = Scene(
        robots=robots,
        doubles=[Double(name="goal", of="lwr", joint_angles=target)],
        frames=[ReceivedFrame(name="seen", relative_to="lwr/link4", frame=T)],
        routes={
            "a.base_frame": "goal/flange",
            "b.base_frame": "seen",
            "c.base_frame": "lwr.fwd_kin_base_to_flange",
        },
        floor=False,
    )
    world, data = placed(scene)
    base = robots[0].base_frame
    expected = {
        "a/base": T_world_flange(robots[0], target, base),
        "b/base": robots[0].dh.frames(Q, base)[4] @ T,
        "seen": robots[0].dh.frames(Q, base)[4] @ T,
        "c/base": inverse(base) @ T_world_flange(robots[0], Q, base),
    }
    for name, T_world in expected.items():
        np.testing.assert_allclose(world.frame(data, name), T_world, atol=1e-12, err_msg=name)


def test_received_frame_is_hidden_before_it_arrives_and_after_nan() -> None:
    world, data = placed(Scene(frames=[ReceivedFrame(name="seen")], floor=False))
    placer = Placer(world)
    assert world.frame(data, "seen")[2, 3] == -1000
    T = frame({"xyz": [0.1, 0.2, 0.3]})
    world.set_input(data, "seen.frame", T)
    placer.place(data)
    np.testing.assert_allclose(world.frame(data, "seen"), T, atol=1e-12)
    data.userdata[world.slots["seen.frame"]] = np.nan
    placer.place(data)
    assert world.frame(data, "seen")[2, 3] == -1000


SCENE = """\
[robots.lwr]
model = "lwr"
[robots.arm]
dh_convention = "craig"
dh_params = [[0.0, 0.0, 0.0, 0.1]]
"""


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            '[routes]\n"arm.base_frame" = "lwr/flang"',
            "s.toml:7: routes.arm.base_frame: no frame 'lwr/flang'; did you mean 'lwr/flange'?",
        ),
        (
            '[routes]\n"arm.torques" = "lwr/flange"',
            "s.toml:7: routes.arm.torques: lwr/flange is a 4 x 4 frame, but "
            "arm.torques takes 1, one per joint",
        ),
        (
            '[routes]\n"arm.base_frame" = "lwr/flange"\n"lwr.base_frame" = "arm/link1"',
            "s.toml:6: routes: frames that depend on each other: arm -> lwr -> arm",
        ),
        (
            '[routes]\n"arm.base_frame" = "lwr.fwd_kin"',
            "s.toml:7: routes.arm.base_frame: no output 'fwd_kin' of lwr; available: "
            "billboard_values, commanded_torques, friction_torques, fwd_kin_base_to_flange, "
            "gravity_torques, joint_accelerations, joint_angles, torques; "
            "frames are written as lwr/flange",
        ),
        (
            '[arrows.f]\nat = "lwr/flang"',
            "s.toml:7: arrows.f.at: no frame 'lwr/flang'; did you mean 'lwr/flange'?",
        ),
        (
            "[arrows.lwr]\nat = [0, 0, 1]",
            "s.toml:6: arrows.lwr: a robot already has this name; expected a different name",
        ),
        (
            '[frames.t]\nrelative_to = "lwr/link9"',
            "s.toml:7: frames.t.relative_to: no frame 'lwr/link9'; available: lwr/base, "
            "lwr/flange, and lwr/linkN of joints 1 A1, 2 A2, 3 E1, 4 A3, 5 A4, 6 A5, 7 A6",
        ),
        ("[toggles]\nlegnd = true", "s.toml:7: toggles.legnd: unknown key; did you mean 'legend'?"),
        (
            '[frames.toggles]\nrelative_to = "world"',
            "s.toml:6: frames.toggles: this name is reserved in routes; expected a different name",
        ),
    ],
)
def test_invalid_frames_are_rejected(tmp_path: Path, text: str, problem: str) -> None:
    file = tmp_path / "s.toml"
    file.write_text(SCENE + text + "\n")
    with pytest.raises(DeclarationError) as caught:
        load_scene(file)
    assert str(caught.value).replace(f"{tmp_path}/", "") == problem


def udp_scene(structure: str, routes: dict[str, str], **fields) -> Scene:
    source = {"kind": "udp", "port": 0, "structure": structure}
    to = {target: f"udp.{event}" for target, event in routes.items()}
    return Scene(sources={"udp": source}, routes=to, floor=False, **fields)


def received(mirror: Mirror, packet: bytes) -> bool:
    """Sends a packet to the mirror, applies it, and returns whether one was applied."""
    source = mirror.sources["udp"]
    before, applied = source.counters.malformed, []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.sendto(packet, ("127.0.0.1", source.port))  # type: ignore[attr-defined]

    def is_known() -> bool:
        applied.append(mirror.advance())
        return applied[-1] or source.counters.malformed > before

    assert until(is_known)
    return applied[-1]


def test_packets_place_bases_frames_and_vectors() -> None:
    robot = arm("arm")
    scene = udp_scene(
        "2F2M2V",
        {"arm.joint_angles": "values0", "arm.base_frame": "matrices0"},
        robots=[robot],
    )
    with pytest.raises(DeclarationError) as caught:
        Mirror(scene)
    assert str(caught.value) == (
        "routes.arm.base_frame: udp.matrices0 is 2 x 4 x 4, but "
        "arm.base_frame takes a 4 x 4 frame, 1M in the structure, or 7 numbers x, y, z, qw, qx, "
        "qy, qz"
    )
    scene = udp_scene(
        "2F1M1V3F",
        {
            "arm.joint_angles": "values0", "arm.base_frame": "matrices0",
            "push.vector": "vectors0", "pull.vector": "values1",
        },
        robots=[robot],
        arrows=[SmartArrow(name="push", at="arm/flange"), SmartArrow(name="pull", at=[0, 0, 1])],
    )  # fmt: skip
    q, T = np.array([0.4, -0.2]), frame(BASE)
    with Mirror(scene) as mirror:
        # Column-major, as in Simulink and the paper.
        numbers = [*q, *T.T.ravel(), 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
        assert received(mirror, np.array(numbers).tobytes())
        world, data = mirror.world, mirror.data
        expected = T_world_flange(robot, q, T)
        np.testing.assert_allclose(world.frame(data, "arm/flange"), expected, atol=1e-12)
        assert data.userdata[world.slots["push.vector"]].tolist() == [1, 2, 3]
        assert data.userdata[world.slots["pull.vector"]].tolist() == [4, 5, 6]
        # Row-major, it is not a frame: counted, not applied.
        numbers[2:18] = T.ravel()
        assert not received(mirror, np.array(numbers).tobytes())
        assert mirror.sources["udp"].counters.not_frames == 1
        np.testing.assert_allclose(world.frame(data, "arm/flange"), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("structure", "route", "expected"),
    [
        # A ROS quaternion: x, y, z, w.
        ("7F", "[udp.values0[0:3], udp.values0[6,3,4,5]]",
         {"xyz": [1, 2, 3], "rpy_deg": [20, 0, 90]}),
        ("3F", "[udp.values0[0:2] * mm, udp.values0[2] * deg]",
         {"xyz": [0.1, 0.2, 0], "rpy_deg": [0, 0, 40]}),
    ],
)  # fmt: skip
def test_base_is_placed_by_position_and_quaternion_or_in_its_plane(
    structure: str, route: str, expected: dict[str, list[float]]
) -> None:
    rest = {"xyz": [5.0, 0.0, 0.5], "rpy_deg": [0, 0, 30]}
    robot = arm("arm", free_base="planar", base_frame=rest)
    scene = udp_scene(structure, {}, robots=[robot])
    scene.routes = {"arm.base_frame": route}
    T = frame(expected) if structure == "7F" else frame(rest) @ frame(expected)
    if structure == "7F":
        w, x, y, z = quat_from_rotation(T[:3, :3])
        numbers, broken = [*T[:3, 3], x, y, z, w], [*T[:3, 3], x, y, z, w + 1]
    else:
        numbers, broken = [100.0, 200.0, 40.0], [100.0, 200.0, np.nan]
    with Mirror(scene) as mirror:
        assert received(mirror, np.array(numbers).tobytes())
        base = mirror.world.frame(mirror.data, "arm/base")
        np.testing.assert_allclose(base, T, atol=1e-12)
        received(mirror, np.array(broken).tobytes())
        np.testing.assert_array_equal(mirror.world.frame(mirror.data, "arm/base"), base)
    motion = MotionPackets(scene)  # it plays the declared frame
    back = motion.source.decode(motion.at(0.0))["values0"].ravel()
    w, x, y, z = quat_from_rotation(frame(rest)[:3, :3])
    played = [*rest["xyz"], x, y, z, w] if structure == "7F" else [0, 0, 0]
    assert back == pytest.approx(played, abs=1e-12)


def test_nan_blanks_displayed_values_and_is_rejected_for_motion() -> None:
    scene = udp_scene(
        "2F2F2F",
        {
            "arm.joint_angles": "values0", "arm.torques": "values1",
            "other.joint_angles": "values2", "arm.billboard_values": "values2",
        },
        robots=[arm("arm"), arm("other", base_frame={"xyz": [1, 0, 0]})],
    )  # fmt: skip
    with Mirror(scene) as mirror:
        slots, data = mirror.world.slots, mirror.data
        assert received(mirror, np.array([0.1, 0.2, np.nan, 7.0, 0.3, 0.4]).tobytes())
        assert data.qpos.tolist() == [0.1, 0.2, 0.3, 0.4]
        np.testing.assert_equal(data.userdata[slots["arm.torques"]], [np.nan, 7.0])
        # The third event moves a robot, too, so NaN in it is an error.
        for at in (0, 5):
            bad = np.array([0.5, 0.5, 1.0, 1.0, 0.5, 0.5])
            bad[at] = np.nan
            assert not received(mirror, bad.tobytes())
        assert data.qpos.tolist() == [0.1, 0.2, 0.3, 0.4]
        counters = mirror.sources["udp"].counters
        assert (counters.blanked, counters.not_finite) == (1, 2)


def test_every_input_of_the_shipped_scene_is_sent() -> None:
    scene = load_scene("lwr_contact")
    scene.sources["udp"] = {**scene.sources["udp"], "port": 0}
    packets = MotionPackets(scene)
    with Mirror(scene) as mirror:
        world, data = mirror.world, mirror.data
        seen = []
        for t in (1.0, 5.0):  # before and after the switch
            assert received(mirror, packets.at(t))
            difference = flange_difference(world, data, "lwr")
            assert difference is not None
            assert max(difference) < 1e-9
            seen.append(data.userdata.copy())
        for target in scene.routes:
            if target not in ("lwr.joint_angles", "lwr.flange_check"):
                slot = world.slots[target]
                assert (seen[0][slot] != seen[1][slot]).any(), target
            assert data.userdata[world.flags[target]] == 1.0
        assert mirror.sources["udp"].counters.malformed == 0
        shown = (seen[1][world.slots[key]] for key in ("lwr.show_arrows", "commanded.visible"))
        assert [float(value[0]) for value in shown] == [1.0, 0.0]


def test_waiting_reports_why_no_packet_was_valid(caplog: pytest.LogCaptureFixture) -> None:
    scene = udp_scene("1M", {"arm.base_frame": "matrices0"}, robots=[arm("arm")])
    with Mirror(scene) as mirror:
        assert not received(mirror, frame(BASE).tobytes())  # row-major
        assert mirror.wait(0.0) == ["udp"]
    assert caplog.messages == [
        "source 'udp': a packet is not applied: matrices0[0] is not a frame: "
        "the last row is [0.2, -0.3, 0.1, 1]; its transpose is a frame. Set column_major = false"
    ]
