"""Routes to some joints of a robot, by names of joints and limbs, and their errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from humanoid import humanoid
from runs import record_packets

from sero_mj.base.errors import DeclarationError
from sero_mj.cli import main
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.drive.place import Placer, Router
from sero_mj.data.drive.record_sources import RoutedSignals
from sero_mj.data.drive.wiring import wire
from sero_mj.data.send.play import MotionPackets
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.double import Double
from sero_mj.robots.declared.groups import Group
from sero_mj.robots.declared.limbs import find_limbs
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.simulate.runs.run_recording import read_run

UDP = {"kind": "udp", "structure": "2F7F3F1F"}
# A fork: a stem of one joint and two branches; the second branch has a coupled joint.
FORK = {
    "joint_frames": [np.eye(4)] * 5,
    "joint_names": ["stem", "l_hip", "l_knee", "r_hip", "r_knee"],
    "parents": ["base", "stem", "l_hip", "stem", "r_hip"],
}


def fork(**fields: Any) -> SerialRobot:
    return SerialRobot(name="fork", **{**FORK, **fields})


def scene_of(routes: dict[str, Any], robot: SerialRobot | None = None, **fields: Any) -> Scene:
    fields = {"robots": [robot or fork()], "sources": {"udp": UDP}, **fields}
    return Scene(routes=routes, floor=False, **fields)


def applied(scene: Scene, **events: Any) -> tuple[World, Any]:
    """Returns the world after packets with these events; `other_values0` is of source `other`."""
    packets: dict[str, dict[str, np.ndarray]] = {}
    for name, values in events.items():
        source, _, event = name.rpartition("_")
        packets.setdefault(source or "udp", {})[event] = np.array(values, float)
    world = World(scene)
    data = world.make_data()
    wiring = wire(scene).check(scene)
    for source in packets:
        direct = [route for route in wiring.routes if route.direct == source]
        Router(world, direct).apply(data, packets)
    Placer(world, wiring).place(data, packets)
    return world, data


def angles(world: World, data: Any, name: str = "fork") -> list[float]:
    return [round(float(q), 9) for q in data.qpos[world.robots[name].qpos]]


def problems_of(
    routes: dict[str, Any], robot: SerialRobot | None = None, **fields: Any
) -> list[str]:
    return [str(problem) for problem in wire(scene_of(routes, robot, **fields)).problems]


def test_named_joints_get_the_values_in_their_order_and_others_are_unchanged() -> None:
    routes = {"fork.joint_angles": {"from": "udp.values0", "joints": ["r_knee", "stem"]}}
    world, data = applied(
        scene_of(routes, fork(joint_angles=[0.1, 0.2, 0.3, 0.4, 0.5])), values0=[7, 8]
    )
    assert angles(world, data) == [8, 0.2, 0.3, 0.4, 7]


def test_torques_of_unnamed_joints_are_no_data() -> None:
    routes = {"fork.torques": {"from": "udp.values0 * mNm", "joints": ["l_knee", "r_hip"]}}
    world, data = applied(scene_of(routes), values0=[5, 6])
    found = data.userdata[world.slots["fork.torques"]]
    np.testing.assert_array_equal(found, [np.nan, np.nan, 0.005, 0.006, np.nan])


def test_limb_is_routed_in_the_key_and_among_joints() -> None:
    routes = {
        "fork.l_leg.joint_angles": "udp.values0",
        "fork.r_leg.joint_angles": "udp.values2[0:2]",
        "fork.torques": {"from": "udp.values2", "joints": ["r_leg", "stem"]},
    }
    world, data = applied(scene_of(routes), values0=[1, 2], values2=[3, 4, 5])
    assert angles(world, data) == [0, 1, 2, 3, 4]
    assert data.userdata[world.slots["fork.torques"]][[3, 4, 0]].tolist() == [3, 4, 5]


def test_limbs_of_several_sources_move_independently() -> None:
    """A silent source does not block the others, and a single number applies to all joints."""
    scene = scene_of(
        {
            "fork.joint_angles": [
                {"from": "udp.values0", "joints": ["l_leg"]},
                {"from": "other.values0", "joints": ["r_leg"]},
                {"from": 0.5, "joints": "stem"},
            ]
        },
        fork(joint_angles=[0, 0, 0, -1, -2]),
        sources={"udp": UDP, "other": {"kind": "udp", "port": 32001, "structure": "2F"}},
    )
    world, data = applied(scene, values0=[1, 2])
    assert angles(world, data) == [0.5, 1, 2, -1, -2]
    world, data = applied(scene, other_values0=[3, 4])
    assert angles(world, data) == [0.5, 0, 0, 3, 4]
    world, data = applied(scene, values0=[1, 2], other_values0=[3, 4])
    assert angles(world, data) == [0.5, 1, 2, 3, 4]


def test_coupled_joints_follow_unless_they_are_named() -> None:
    couplings = {"r_knee": {"to": "r_hip", "ratio": -2.0, "offset": 0.1}}
    routes = {"fork.joint_angles": {"from": "udp.values0", "joints": ["stem", "r_hip"]}}
    world, data = applied(scene_of(routes, fork(couplings=couplings)), values0=[1, 2])
    assert angles(world, data) == [1, 0, 0, 2, -3.9]
    for source, expected in (("udp.values0", [0, 1, 2]), ("udp.values3", [0, 1, -1.9])):
        scene = scene_of({"fork.r_leg.joint_angles": source}, fork(couplings=couplings))
        world, data = applied(scene, values0=[1, 2], values3=[1])
        assert angles(world, data)[2:] == expected
    routes = {"fork.torques": {"from": "udp.values3", "joints": ["r_hip"]}}
    world, data = applied(scene_of(routes, fork(couplings=couplings)), values3=[3])
    found = data.userdata[world.slots["fork.torques"]]
    np.testing.assert_array_equal(found, [np.nan, np.nan, np.nan, 3, np.nan])


def test_double_has_the_joint_names_of_its_robot() -> None:
    scene = scene_of(
        {"goal.r_leg.joint_angles": "udp.values0"},
        fork(joint_angles=[0.1] * 5),
        doubles=[Double(name="goal", of="fork")],
    )
    world, data = applied(scene, values0=[1, 2])
    found = data.userdata[world.slots["goal.joint_angles"]]
    np.testing.assert_array_equal(found, [0.1, 0.1, 0.1, 1, 2])


def test_group_has_the_joints_of_its_robots_with_prefixed_names() -> None:
    robots = [fork(), fork().model_copy(update={"name": "twin"})]
    routes = {
        "both.joint_angles": [
            {"from": "udp.values1", "joints": ["twin", "fork_stem", "fork_r_knee"]},
        ]
    }
    scene = scene_of(routes, robots=robots, groups=[Group(name="both", robots=["fork", "twin"])])
    world, data = applied(scene, values1=[1, 2, 3, 4, 5, 6, 7])
    assert angles(world, data) == [6, 0, 0, 0, 7]
    assert angles(world, data, "twin") == [1, 2, 3, 4, 5]


def test_each_error_is_reported_once() -> None:
    two = {"from": "udp.values0", "joints": ["l_kneee", "l_hip", "foot", "foot"]}
    place = "routes.fork.joint_angles: "
    assert problems_of({"fork.joint_angles": two}) == [
        f"{place}fork has no joint or limb 'l_kneee'; did you mean 'l_knee'?",
        f"{place}fork has no joint or limb 'foot'; available: l_hip, l_knee, l_leg, "
        "r_hip, r_knee, r_leg, stem",
    ]
    three = {"from": "udp.values0", "joints": ["l_leg", "stem"]}
    assert problems_of({"fork.joint_angles": three}) == [
        f"{place}udp.values0 has 2 values, but fork.joint_angles takes 3: l_hip, l_knee, stem"
    ]
    assert problems_of({"fork.arm.torques": "udp.values0"}) == [
        "routes.fork.arm.torques: fork has no joint or limb 'arm'; available: l_hip, l_knee, "
        "l_leg, r_hip, r_knee, r_leg, stem"
    ]
    twice = {"fork.joint_angles": three | {"from": "udp.values2"}, "fork.l_leg.joint_angles": 0}
    assert problems_of(twice) == [
        "routes.fork.l_leg.joint_angles: route fork.joint_angles already sets joint_angles of "
        "l_hip; expected one route per joint"
    ]
    assert problems_of({"fork.torques": "udp.values1[0:5]", "fork.l_leg.torques": 0.0}) == [
        "routes.fork.l_leg.torques: route fork.torques already sets torques of l_hip; expected one "
        "route per joint"
    ]
    again = {"from": "udp.values2", "joints": ["l_leg", "l_hip"]}
    assert problems_of({"fork.torques": again}) == [
        "routes.fork.torques: l_hip occurs twice; expected each joint once"
    ]
    assert problems_of({"fork.l_leg.joint_angles": "udp.values0 * Nm"}) == [
        "routes.fork.l_leg.joint_angles: udp.values0 * Nm is a torque (Nm), but fork.joint_angles "
        "takes an angle (rad)"
    ]
    assert problems_of({"fork.l_leg.base_frame": "udp.values0"}) == [
        "routes.fork.l_leg.base_frame: joint names are only for inputs with a value per joint, but "
        "fork.base_frame takes a 4 x 4 frame"
    ]
    assert problems_of({"fork.l_leg.torqes": "udp.values0"}) == [
        "routes.fork.l_leg.torqes: no input 'torqes' of fork; did you mean 'torques'?"
    ]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"from": "udp.values0"}, "found no 'joints'; expected { from = "),
        (
            {"form": "udp.values0", "joints": ["a"]},
            "unknown 'form'; did you mean 'from'?, no 'from'",
        ),
        ({"from": "udp.values0", "joints": [1]}, "joints: found [1]; expected names of joints"),
        ({"from": True, "joints": ["a"]}, "found true; expected an event"),
        ([{"from": 1, "joints": ["a"]}, 3], "found 3 in a list of tables"),
    ],
)
def test_invalid_route_table_is_rejected(table: Any, message: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        scene_of({"fork.joint_angles": table})
    assert message in str(caught.value)


SCENE = """\
[robots.fork]
joint_frames = [{}, {}, {}, {}, {}]
joint_names = ["stem", "l_hip", "l_knee", "r_hip", "r_knee"]
parents = ["base", "stem", "l_hip", "stem", "r_hip"]

[sources.udp]
kind = "udp"
port = 0
structure = "3F2F3F"

[routes]
"fork.joint_angles" = [
    { from = "udp.values0", joints = ["l_leg", "stem"] },
    { from = "udp.values1 * deg", joints = ["r_knee", "r_hip"] },
]
"fork.torques" = { from = "udp.values2", joints = ["r_leg", "stem"] }
""".replace("{}", "{ xyz = [0.0, 0.1, 0.3], rpy = [1.5708, 0.0, 0.0] }")


def test_file_contains_route_tables_and_check_prints_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "fork.toml"
    file.write_text(SCENE, "utf-8")
    with pytest.raises(SystemExit) as caught:
        main(["check", str(file)])
    out = capsys.readouterr().out
    assert caught.value.code == 0
    assert "  route   udp.values0 -> fork.joint_angles: l_leg, stem\n" in out
    assert "  route   udp.values1 * deg -> fork.joint_angles: r_knee, r_hip\n" in out
    assert "          limbs: stem 1, l_leg 2, r_leg 2\n" in out
    file.write_text(SCENE.replace('"stem"] },', '"stemm"] },'), "utf-8")
    with pytest.raises(DeclarationError) as wrong:
        Mirror(load_scene(file))
    assert "fork.toml:12: routes.fork.joint_angles: fork has no joint or limb 'stemm'" in str(
        wrong.value
    )
    scene = load_scene(file, {"fork.joint_angles": [1.0, 0.0, 0.0, 0.0, 0.0]})
    assert list(scene.routes) == ["fork.torques"]


def test_sent_packets_have_the_routed_layout(tmp_path: Path) -> None:
    """The packets of a sender are received as the motion that it played."""
    file = tmp_path / "fork.toml"
    file.write_text(SCENE, "utf-8")
    scene = load_scene(file)
    packets = MotionPackets(scene)
    values = packets.structure.decode(packets.at(0.7))
    world, data = applied(scene, **values)
    whole = scene_of({"fork.joint_angles": "udp.values0", "fork.torques": "udp.values1"},
                     sources={"udp": {"kind": "udp", "structure": "5F5F"}})  # fmt: skip
    robot = scene.robots["fork"]
    other = MotionPackets(Scene(robots=[robot], sources=whole.sources, routes=whole.routes))
    wanted = other.structure.decode(other.at(0.7))
    np.testing.assert_allclose(data.qpos[world.robots["fork"].qpos], wanted["values0"], atol=1e-9)
    torques = data.userdata[world.slots["fork.torques"]]
    np.testing.assert_allclose(torques[[3, 4, 0]], wanted["values1"][[3, 4, 0]], atol=1e-9)
    assert np.isnan(torques[[1, 2]]).all()


def test_recordings_name_the_joints_and_their_origins() -> None:
    routes = {"fork.joint_angles": {"from": "udp.values0 * deg", "joints": ["r_knee", "stem"]}}
    scene = scene_of(routes)
    wiring = wire(scene)
    signals = RoutedSignals(scene, wiring.routes, "udp", wiring.sources["udp"].events)
    assert signals.signals.origins == {
        "fork.r_knee.angle [rad]": "(udp.values0 * deg)[0]",
        "fork.stem.angle [rad]": "(udp.values0 * deg)[1]",
    }
    found = signals.of({"values0": np.array([180.0, 90.0]), "values1": np.zeros(7),
                        "values2": np.zeros(3), "values3": np.zeros(1)})  # fmt: skip
    np.testing.assert_allclose(found["fork.joint_angles"], [np.pi / 2, 0, 0, 0, np.pi])


def test_limbs_are_unbranched_and_named_by_common_prefixes() -> None:
    robot = humanoid()
    limbs = {name: [robot.names[i] for i in joints] for name, joints in robot.limb_joints.items()}
    assert list(limbs) == [
        "l_leg", "r_leg", "torso", "l_arm", "l_thumb", "l_index", "l_middle", "l_ring", "l_little",
        "r_arm", "r_thumb", "r_index", "r_middle", "r_ring", "r_little", "neck",
    ]  # fmt: skip
    assert limbs["l_index"] == ["l_index_base", "l_index_middle", "l_index_tip"]
    assert sorted(name for names in limbs.values() for name in names) == sorted(robot.names)
    assert SerialRobot.from_model("lwr").limb_joints == {"A1-A6": [*range(7)]}


def test_limb_names_are_unique_and_coupled_joints_belong_to_their_driver() -> None:
    names = ["j1", "j2", "grip", "tip_a", "tip_b", "x_1", "x_2", "x_3", "x_4"]
    carriers = [0, 1, 2, 2, 2, 0, 6, 0, 8]
    followed = {"tip_a": "grip", "tip_b": "tip_a"}
    assert find_limbs(names, carriers, followed) == {
        "j1-j2": [0, 1], "grip-tip_b": [2, 3, 4], "x_1-x_2": [5, 6], "x_3-x_4": [7, 8],
    }  # fmt: skip


def test_declared_limbs_are_used_and_their_errors_reported() -> None:
    robot = fork(limbs={"legs": ["l_hip", "r_hip", "r_knee"]})
    assert robot.limb_joints == {"stem": [0], "legs": [1, 3, 4], "l_knee": [2]}
    with pytest.raises(DeclarationError) as caught:
        fork(limbs={"a": ["l_hip", "nee"], "stem": ["l_hip"], "b": []})
    text = str(caught.value)
    assert "limbs.a.1: no joint 'nee'" in text
    assert "limbs.stem: a joint already has this name" in text
    assert "limbs.stem.0: l_hip is already in a; expected it in only one limb" in text
    assert "limbs.b: found no joints; expected one or more" in text


def test_recorded_packets_are_read_through_the_same_routes(tmp_path: Path) -> None:
    rng, times = np.random.default_rng(8), np.arange(1, 40) * 0.01
    rows = {"values0": rng.normal(size=(39, 3)), "values1": rng.normal(size=(39, 2)),
            "values2": rng.normal(size=(39, 3))}  # fmt: skip
    path = tmp_path / "real.mcap"
    one_limb = SCENE.replace(
        '"fork.torques"', '"fork.l_leg.commanded_torques" = "udp.values1"\n"fork.torques"'
    )
    record_packets(path, "3F2F3F", rows, times, {"scenes/fork.toml": one_limb})
    run = read_run(path)
    q = run.of("fork", "joint_angles")
    np.testing.assert_allclose(q[:, [1, 2, 0]], rows["values0"], atol=1e-12)
    np.testing.assert_allclose(q[:, [4, 3]], np.deg2rad(rows["values1"]), atol=1e-12)
    torques = run.of("fork", "torques")
    np.testing.assert_allclose(torques[:, [3, 4, 0]], rows["values2"], atol=1e-12)
    assert np.isnan(torques[:, [1, 2]]).all()
    commanded = run.of("fork", "commanded_torques")
    np.testing.assert_allclose(commanded[:, [1, 2]], rows["values1"], atol=1e-12)
