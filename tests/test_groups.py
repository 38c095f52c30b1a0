"""Groups of robots: shared routes, switches, defaults and doubles."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import problems_in, raises_with
from decor_tools import labels, toggles_of, view_at
from scripted_widgets import ScriptedWidgets
from source_slots import set_source

from sero_mj import (
    DeclarationError,
    Double,
    Group,
    Mirror,
    Scene,
    SerialRobot,
    World,
    load_scene,
)
from sero_mj.base.errors import UnknownName
from sero_mj.cli import main
from sero_mj.data.drive.place import Placer, Router
from sero_mj.data.drive.wiring import wire
from sero_mj.data.send.play import MotionPackets
from sero_mj.simulate.scenario import Scenario
from sero_mj.viewer.decor.billboards import declared_lines
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.toggles import Toggles
from sero_mj.viewer.panels.robot_panel import RobotPanel
from sero_mj.viewer.program.memory import SceneMemory
from sero_mj.viewer.program.robot_inputs import RobotInputs

COUNTS = {"torso": 2, "left": 3, "right": 3, "head": 1}


def robot(name: str, **fields: Any) -> SerialRobot:
    rows = [[0.0, 0.0, 0.0, 0.3], *[[1.5, 0.1, 0.0, 0.0]] * (COUNTS[name] - 1)]
    return SerialRobot(name=name, dh_convention="craig", dh_params=rows, **fields)


def justin(routes: dict[str, Any] | None = None, structure: str = "9F9F", **fields: Any) -> Scene:
    """Returns arms with a coupled joint on a torso, in a group of their own that is listed last."""
    on = {"mount": "torso/flange", "couplings": {"J3": {"to": "J2", "ratio": 2.0}}}
    return Scene(
        robots=[
            robot("left", **on), robot("right", **on),
            robot("head", mount="torso/link1"), robot("torso"),
        ],
        groups=[
            Group(name="justin", robots=["torso", "head", "arms"], show_arrows=True),
            Group(name="arms", robots=["left", "right"], billboard_scale=0.07),
        ],
        sources={"udp": {"kind": "udp", "port": 0, "structure": structure}},
        routes=routes or {}, floor=False, **fields,
    )  # fmt: skip


def received(scene: Scene, **values: Any) -> tuple[World, Any]:
    wiring = wire(scene).check(scene)
    world = World(scene)
    data = world.make_data()
    arrays = {key: np.array(numbers, float) for key, numbers in values.items()}
    Router(world, wiring.routes).apply(data, {"udp": arrays})
    Placer(world, wiring).place(data, {"udp": arrays})
    return world, data


def angles(world: World, data: Any) -> dict[str, list[float]]:
    return {name: data.qpos[part.qpos].tolist() for name, part in world.robots.items()}


def route_problems(scene: Scene) -> list[str]:
    return [str(problem) for problem in wire(scene).problems]


def test_route_to_a_group_gives_every_robot_its_slice_in_order() -> None:
    scene = justin({"justin.joint_angles": "udp.values0", "justin.torques": "-2 * udp.values1"})
    world, data = received(scene, values0=np.arange(9.0), values1=np.arange(9.0))
    assert angles(world, data) == {
        "torso": [0.0, 1.0], "head": [2.0], "left": [3.0, 4.0, 5.0], "right": [6.0, 7.0, 8.0],
    }  # fmt: skip
    assert data.userdata[world.slots["head.torques"]].tolist() == [-4.0]
    assert data.userdata[world.slots["right.torques"]].tolist() == [-12.0, -14.0, -16.0]


def test_coupled_joints_can_be_omitted_from_the_packet_of_a_group() -> None:
    scene = justin(
        {"justin.joint_angles": "udp.values0 * deg", "arms.torques": "udp.values1"}, "7F4F"
    )
    world, data = received(scene, values0=[0, 1, 2, 3, 4, 5, 6], values1=[1, 2, 3, 4])
    right = np.rad2deg(data.qpos[world.robots["right"].qpos])
    np.testing.assert_allclose(right, [5, 6, 12])
    torques = data.userdata[world.slots["right.torques"]]
    np.testing.assert_array_equal(torques, [3, 4, np.nan])


def test_wrong_size_is_reported_with_the_count_of_every_robot() -> None:
    scene = justin({"justin.joint_angles": "udp.values0[0:8]", "justin.torques": "udp.values1"})
    assert route_problems(scene) == [
        "routes.justin.joint_angles: udp.values0[0:8] has 8 values, but justin.joint_angles takes "
        "9: torso 2, head 1, left 3, right 3, or 7 without the coupled joints"
    ]


def test_mistyped_inputs_and_groups_are_reported_by_the_declared_key() -> None:
    scene = justin({"justin.torqes": "udp.values0", "justn.torques": "udp.values0"})
    assert route_problems(scene) == [
        "routes.justin.torqes: no input 'torqes' of justin; did you mean 'torques'?",
        "routes.justn.torques: no robot 'justn'; did you mean 'justin'?",
    ]


def test_two_routes_to_one_input_are_rejected() -> None:
    scene = justin({"justin.torques": "udp.values0", "left.torques": "udp.values1[0:3]"})
    assert route_problems(scene) == [
        "routes.left.torques: left.torques already has the route justin.torques. Remove one of them"
    ]


def test_input_that_not_all_robots_have_is_rejected() -> None:
    robots = [robot("left", inputs=["currents"]), robot("right")]
    scene = Scene(
        robots=robots, groups=[Group(name="arms", robots=["left", "right"])],
        sources={"udp": {"kind": "udp", "port": 0, "structure": "6F"}},
        routes={"arms.currents": "udp.values0"},
    )  # fmt: skip
    assert route_problems(scene) == [
        "routes.arms.currents: 'currents' is an input of left, but not of right; expected an "
        "input that all robots of arms have"
    ]


def test_base_of_a_group_is_the_base_of_its_unmounted_robot() -> None:
    scene = justin({"justin.base_frame": "udp.matrices0"}, "1M")
    T = np.eye(4)
    T[:3, 3] = 1.0, 2.0, 3.0
    world, data = received(scene, matrices0=T[None])
    np.testing.assert_allclose(world.frame(data, "torso/base"), T)
    np.testing.assert_allclose(world.frame(data, "head/base")[:3, 3], [1.0, 2.0, 3.3])


def test_switch_of_a_group_switches_all_its_robots() -> None:
    scene = justin(
        {"justin.show_arrows": "not udp.values0", "arms.show_axes": "udp.values1"}, "1F1F"
    )
    world, data = received(scene, values0=[1.0], values1=[1.0])
    toggles = Toggles(world)
    assert toggles.arrows.all()  # as the group declares
    toggles.apply_inputs(data)
    assert not toggles.arrows.any()
    owners = list(world.owners)
    shown = {owners[i] for i in world.frames.owner[toggles.axes]}
    assert shown == {"left", "right"}


def test_outputs_of_a_group_can_be_routed() -> None:
    routes = {"left.billboard_values": "arms.joint_angles[3:6]"}
    routes["right.joint_angles"] = "udp.values0"
    world, data = received(justin(routes, "3F"), values0=[1.0, 2.0, 3.0])
    assert data.userdata[world.slots["left.billboard_values"]].tolist() == [1.0, 2.0, 3.0]


def test_robot_fields_override_group_defaults() -> None:
    groups = [
        Group(name="all", robots=["pair", "head"], show_axes=True, billboard_scale=0.09),
        Group(name="pair", robots=["left", "right"], billboard_scale=0.07),
    ]
    mine = robot("left", show_axes=False)
    scene = Scene(robots=[mine, robot("right"), robot("head"), robot("torso")], groups=groups)
    found = {name: (each.show_axes, each.billboard_scale) for name, each in scene.robots.items()}
    assert found == {
        "left": (False, 0.07), "right": (True, 0.07), "head": (True, 0.09), "torso": (False, 0.05),
    }  # fmt: skip
    assert mine.billboard_scale == 0.05  # the argument is not changed


def test_staleness_and_billboard_lines_follow_the_routes_of_the_group() -> None:
    scene = justin({"justin.joint_angles": "udp.values0", "arms.torques": "udp.values1"},
                   "9F6F")  # fmt: skip
    world = World(scene)
    assert scene.sources_of("head.joint_angles") == {"udp"}
    assert scene.sources_of("head.torques") == set()
    lines = [line.value for line in declared_lines(world.owners["left"], scene)]
    assert lines == ["torques"]
    assert [line.value for line in declared_lines(world.owners["head"], scene)] == ["joint_angles"]


def test_double_of_a_group_has_doubles_of_all_robots_on_each_other() -> None:
    at = np.array([0.4, 0.3, 0.5, 0.1, 0.2, 0.4, 0.3, 0.1, 0.2])
    double = Double(name="goal", of="justin", joint_angles=at, rgba=[1, 0, 0, 0.5])
    scene = justin({"goal.visible": "udp.values0"}, "1F", doubles=[double])
    assert list(scene.doubles) == ["goal_torso", "goal_head", "goal_left", "goal_right"]
    mirror = Mirror(scene)
    mirror.advance(0.0)
    world, data = mirror.world, mirror.data
    # By hand: the goal's arm is on the goal's torso, not on the robot's.
    torso, left = scene.robots["torso"], scene.robots["left"]
    base = torso.base_frame @ torso.fwd_kin_base_to_flange(at[:2]) @ left.base_frame
    np.testing.assert_allclose(
        world.frame(data, "goal_left/flange"), base @ left.fwd_kin_base_to_flange(at[3:6]),
        atol=1e-12,
    )  # fmt: skip
    first = data.xpos[world.doubles["goal_left"].bodies[0, 0]]
    np.testing.assert_allclose(first, base[:3, 3], atol=1e-12)


def test_doubles_without_a_pose_stay_at_their_robots() -> None:
    doubles = [Double(name="goal", of="justin")]
    scene = justin({"goal_left.joint_angles": "udp.values0"}, "3F", doubles=doubles)
    world, data = received(scene, values0=[0.1, 0.2, 0.3])
    torso, left = scene.robots["torso"], scene.robots["left"]
    base = torso.base_frame @ torso.fwd_kin_base_to_flange(torso.home) @ left.base_frame
    expected = base @ left.fwd_kin_base_to_flange([0.1, 0.2, 0.3])
    np.testing.assert_allclose(world.frame(data, "goal_left/flange"), expected, atol=1e-12)


def test_sent_packet_moves_all_robots_of_a_group() -> None:
    scene = justin({"justin.joint_angles": "udp.values0", "justin.torques": "udp.values1"})
    packets = MotionPackets(scene)
    values = np.frombuffer(packets.at(0.4), "<f8")
    world, data = received(scene, values0=values[:9], values1=values[9:])
    found = angles(world, data)
    assert all(np.abs(values).max() > 0.01 for values in found.values())
    assert found["left"][2] == pytest.approx(2.0 * found["left"][1])
    assert np.abs(values[9:]).max() > 0.1  # torques that hold the robots


WRONG = """\
[robots.a]
model = "lwr"

[robots.b]
model = "lwr"

[groups.one]
robots = ["a", "bb"]
show_arrows = 3

[groups.two]
robots = ["a", "three", "cc"]

[groups.three]
robots = ["b", "four"]

[groups.four]
robots = ["three"]

[groups.five]
robots = ["a", "b", "a"]
show_axes = true

[groups.six]
robots = ["b"]
show_axes = false

[groups.c]
robots = ["b"]

[groups.seven]
robots = []

[robots.c]
model = "lwr"
"""


def test_invalid_groups_are_reported_together_with_their_lines(tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(WRONG)
    assert problems_in(path) == [
        "9: groups.one.show_arrows: found 3; expected true or false",
        "12: groups.two.robots: no robot or group 'cc'; did you mean 'c'?",
        "15: groups.three.robots: groups contain each other: three in four in three",
        "21: groups.five.robots: the group contains 'a' twice, so its share of the "
        "values is ambiguous",
        "26: groups.six.show_axes: 'b' is also in the group five, which has a different show_axes",
        "28: groups.c: a robot already has this name; expected a different name",
        "32: groups.seven.robots: found []; expected 1 entry or more",
    ]


def test_group_values_can_be_overridden_on_the_command_line(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(
        '[robots.a]\nmodel = "lwr"\nshow_arrows = false\n[robots.b]\nmodel = "lwr"\n'
        '[groups.pair]\nrobots = ["a", "b"]\n[groups.all]\nrobots = ["pair"]\n'
        '[sources.udp]\nkind = "udp"\nport = 32000\nstructure = "1F"\n'
        '[routes]\n"all.show_arrows" = "udp.values0"\n'
    )
    scene = load_scene(path, {"all.show_arrows": True})
    assert [each.show_arrows for each in scene.robots.values()] == [True, True]
    assert scene.routes == {}


def test_invalid_group_is_not_reported_again_by_its_routes(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(
        """[robots.a]
model = "lwr"
[groups.pair]
robots = ["a"]
show_arows = true
[groups.other]
robots = ["a", "q"]
[sources.udp]
kind = "udp"
port = 0
structure = "7F7F"
[routes]
"pair.joint_angles" = "udp.values0"
"pair.torqes" = "udp.values1"
"pair.torques" = "udp.values2"
"other.torques" = "udp.values1"
"""
    )
    assert problems_in(path) == [
        "5: groups.pair.show_arows: unknown key; did you mean 'show_arrows'?",
        "7: groups.other.robots: no robot or group 'q'; available: a, pair",
        "14: routes.pair.torqes: no input 'torqes' of pair; did you mean 'torques'?",
        "15: routes.pair.torques: no event 'values2' of udp; did you mean 'values1'?",
    ]


POSED = """
[robots.a]
model = "lwr"
joint_angles = [1, 1, 1, 1, 1, 1, 1]
[robots.b]
dh_convention = "craig"
dh_params = [[0, 0, 0, 0.3], [1.5, 0, 0, 0], [0, 0.1, 0, 0]]
couplings = { J3 = { to = "J2", ratio = 2.0 } }
[groups.pair]
robots = ["b", "a"]
joint_angles = [0.1, 0.2, 1, 2, 3, 4, 5, 6, 7]
torques = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]
[sources.udp]
kind = "udp"
port = 0
structure = "2F9F3F"
[routes]
"b.joint_angles" = "udp.values0"
"pair.torques" = "udp.values1"
"b.billboard_values" = "udp.values2"
"""


def posed(folder: Path, **overrides: Any) -> Scene:
    path = folder / "posed.toml"
    path.write_text(POSED)
    return load_scene(path, {key.replace("__", "."): each for key, each in overrides.items()})


def test_group_declares_values_shared_by_its_robots(tmp_path: Path) -> None:
    scene = posed(tmp_path)
    np.testing.assert_allclose(scene.robots["b"].home, [0.1, 0.2, 0.4])  # not the robot's zeros
    np.testing.assert_array_equal(scene.robots["a"].home, range(1, 8))
    world = World(scene)
    data = world.make_data()
    assert data.userdata[world.slots["b.torques"]].tolist() == [1, 2, 3]
    assert data.userdata[world.slots["a.torques"]].tolist() == [*range(4, 11)]
    assert set(scene.routes) == {"b.joint_angles", "pair.torques", "b.billboard_values"}
    groups = [
        Group(name="inner", robots=["left"], joint_angles=[1, 2, 3]),
        Group(name="outer", robots=["head", "inner"], joint_angles=[9, 6, 7, 8]),
    ]
    mine = robot("head", joint_angles=[0.5])
    scene = Scene(robots=[robot("left"), mine], groups=groups[::-1])
    assert [each.home.tolist() for each in scene.robots.values()] == [[6, 7, 8], [9]]
    assert mine.home.tolist() == [0.5]  # the argument is not changed
    late = Scene(robots=[robot("left")], groups=groups[:1])
    assert late.robots["left"].home.tolist() == [1, 2, 3]


def test_group_poses_can_be_overridden_on_the_command_line(tmp_path: Path) -> None:
    scene = posed(tmp_path, pair__joint_angles=[*range(9)], pair__torques=[*range(9)])
    np.testing.assert_allclose(scene.robots["b"].home, [0, 1, 2])
    np.testing.assert_array_equal(scene.robots["a"].home, range(2, 9))
    assert set(scene.routes) == {"b.billboard_values"}  # values that are set have no routes
    scene = posed(tmp_path, a__joint_angles=[0] * 7, pair__billboard_values=[1] * 10)
    # A robot's value takes precedence over its group's.
    assert scene.robots["a"].home.tolist() == [0] * 7
    np.testing.assert_allclose(scene.robots["b"].home, [0.1, 0.2, 0.4])
    assert set(scene.routes) == {"b.joint_angles", "pair.torques"}
    scene = posed(tmp_path, **{"a__joint_angles[2]": 0.5})
    assert scene.robots["a"].home.tolist() == [1, 2, 0.5, 4, 5, 6, 7]


def test_groups_and_doubles_accept_poses_in_degrees(tmp_path: Path) -> None:
    shared = "joint_angles = [0.1, 0.2, 1, 2, 3, 4, 5, 6, 7]"
    in_degrees = POSED.replace(shared, "joint_angles_deg = [10, 20, 1, 2, 3, 4, 5, 6, 7]")
    goal = '[doubles.goal]\nof = "pair"\njoint_angles_deg = [1, 2, 3, 4, 5, 6, 7, 8, 90]\n'
    path = tmp_path / "posed.toml"
    path.write_text(goal + in_degrees)
    scene = load_scene(path)
    np.testing.assert_allclose(np.rad2deg(scene.robots["b"].home), [10, 20, 40])
    np.testing.assert_allclose(np.rad2deg(scene.robots["a"].home), range(1, 8))
    of_a, of_b = scene.doubles["goal_a"].joint_angles, scene.doubles["goal_b"].joint_angles
    assert of_a is not None and of_b is not None
    np.testing.assert_allclose(np.rad2deg([*of_a, *of_b]), [3, 4, 5, 6, 7, 8, 90, 1, 2])
    # A value set in one unit replaces the other, in files and in overrides.
    scene = posed(tmp_path, pair__joint_angles_deg=[*range(9)])
    np.testing.assert_allclose(np.rad2deg(scene.robots["a"].home), range(2, 9))
    assert set(scene.routes) == {"pair.torques", "b.billboard_values"}
    scene = posed(tmp_path, a__joint_angles_deg=[10] * 7)
    np.testing.assert_allclose(np.rad2deg(scene.robots["a"].home), [10] * 7)
    assert set(scene.routes) == {"b.joint_angles", "pair.torques", "b.billboard_values"}
    types = '[robots.b]\njoint_types = ["revolute", "revolute", "prismatic"]'
    sliding = POSED.replace("[robots.b]", types)
    path.write_text(goal + sliding.replace("joint_angles = [0.1", "joint_angles_deg = [0.1"))
    problems = [each for each in problems_in(path) if "joint_angles_deg" in each]
    assert len(problems) == 2
    assert problems[0].startswith(
        "3: doubles.goal.joint_angles_deg: is for revolute joints only, but b"
    )
    assert ": groups.pair.joint_angles_deg: is for revolute joints only, but b" in problems[1]
    with raises_with(reason="found both joint_angles and joint_angles_deg; expected only one"):
        Double(name="goal", of="a", joint_angles=[0], joint_angles_deg=[0])


def test_wrong_values_of_a_group_are_reported_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def printed_problems(setting: str) -> list[str]:
        path = tmp_path / "posed.toml"
        path.write_text(POSED)
        command = ["render", str(path), "-o", str(tmp_path / "x.png"), "--set", setting]
        with pytest.raises(SystemExit, match="2"):
            main(command)
        return capsys.readouterr().err.removeprefix("sero-mj: ").splitlines()

    expected = "expected 10 (b 3, a 7), or 9 without the coupled joints"
    assert printed_problems("pair.joint_angles=1,2") == [
        f"--set pair.joint_angles: found values of 2 joints; {expected}"
    ]
    assert printed_problems("pair.show_axs=true") == [
        "--set pair.show_axs: no robot has this field; did you mean 'show_axes'?"
    ]
    assert printed_problems("pair.show_axes=3") == [
        "--set pair.show_axes: found 3; expected true or false"
    ]
    assert printed_problems("piar.show_axes=true") == [
        "--set piar.show_axes: no robot 'piar' to set this for; did you mean 'pair'?"
    ]
    scene = POSED.replace("[0.1, 0.2, 1,", "[0.1, 0.2, 0.5, 1,").replace("9, 10]", "9]")
    (tmp_path / "wrong.toml").write_text(scene)
    assert problems_in(tmp_path / "wrong.toml") == [
        "11: groups.pair.joint_angles: found 0.5 for J3; expected 0.4 because of its coupling"
    ]
    (tmp_path / "wrong.toml").write_text(POSED.replace("9, 10]", "9, 10, 11]"))
    assert problems_in(tmp_path / "wrong.toml") == [
        f"12: groups.pair.torques: found values of 11 joints; {expected}"
    ]


def test_inputs_of_groups_are_set_by_the_group_name() -> None:
    world = World(justin(doubles=[Double(name="goal", of="arms")]))
    data = world.make_data()
    world.set_input(data, "justin.joint_angles", np.arange(7.0) / 10)
    np.testing.assert_allclose(angles(world, data)["right"], [0.5, 0.6, 1.2])
    np.testing.assert_allclose(angles(world, data)["torso"], [0.0, 0.1])
    world.set_input(data, "justin.torques", [*range(8), np.nan])
    assert data.userdata[world.slots["left.torques"]].tolist() == [3, 4, 5]
    np.testing.assert_array_equal(data.userdata[world.slots["right.torques"]], [6, 7, np.nan])
    world.set_input(data, "goal.joint_angles", [1, 2, 4, 5, 6, 12])
    assert data.userdata[world.slots["goal_right.joint_angles"]].tolist() == [5, 6, 12]
    world.set_input(data, "arms.show_axes", True)
    T = np.eye(4)
    T[0, 3] = 2.0
    world.set_input(data, "justin.base_frame", T)
    assert data.mocap_pos[world.placed["torso"]].tolist() == [2, 0, 0]
    toggles = Toggles(world)
    toggles.apply_inputs(data)
    owners = list(world.owners)
    assert {owners[i] for i in world.frames.owner[toggles.axes]} == {"left", "right"}


def test_wrong_inputs_of_groups_are_reported_by_the_group_name() -> None:
    world = World(justin(doubles=[Double(name="goal", of="arms")]))
    data = world.make_data()
    each = "(torso 2, head 1, left 3, right 3), or 7 without the coupled joints"
    wrong: list[tuple[str, Any, str]] = [
        ("justin.joint_angles", [0.0] * 8,
         f"justin.joint_angles: found 8 numbers; expected 9 finite numbers {each}"),
        ("justin.joint_angles", [0.0] * 6 + [np.nan],
         "justin.joint_angles: found [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, nan]; expected 9 finite "
         f"numbers {each}"),
        ("justin.torques", "no", f"justin.torques: found 'no'; expected 9 numbers {each}"),
        ("justin.torqes", [0.0] * 9, "no input 'torqes' of justin; did you mean 'torques'?"),
        ("justn.torques", [0.0] * 9, "no robot 'justn'; did you mean 'justin'?"),
        ("arms.flange_check", np.eye(4),
         "arms.flange_check: one frame cannot set flange_check of several robots (left, right); "
         "expected a single robot"),
    ]  # fmt: skip
    for target, values, text in wrong:
        with pytest.raises((UnknownName, ValueError)) as caught:
            world.set_input(data, target, values)
        assert str(caught.value) == text
    np.testing.assert_array_equal(data.qpos, 0.0)  # no robot is set if one value is invalid


def test_viewer_forwards_inputs_set_for_a_group() -> None:
    worlds = [World(justin()) for _ in range(2)]
    user, shown = worlds[0].make_data(), worlds[1].make_data()
    memory = SceneMemory(worlds[0], user)
    other = SceneMemory(worlds[1], shown, memory.arrays.path)
    memory.set("justin.joint_angles", np.arange(9.0))
    memory.set("arms.show_axes", True)
    other.apply()
    assert angles(worlds[1], shown) == angles(worlds[0], user)
    assert angles(worlds[1], shown)["right"] == [6, 7, 8]
    assert shown.userdata[worlds[1].slots["left.show_axes"]].tolist() == [1]
    viewer = SimpleNamespace(world=worlds[0], data=user, set=memory.set)
    inputs = RobotInputs(viewer, "arms")
    inputs.torques = [1, 2, 4, 5]
    np.testing.assert_array_equal(inputs.torques, [1, 2, np.nan, 4, 5, np.nan])
    with raises_with(UnknownName, kind="robot", name="amrs", near="arms"):
        RobotInputs(viewer, "amrs")


def test_group_of_too_many_robots_is_rejected() -> None:
    with pytest.raises(DeclarationError) as caught:
        Group(name="crowd", robots=["r"] * 401)
    assert str(caught.value) == "robots: found 401 entries; expected at most 400"


def test_deeply_nested_groups_are_resolved_quickly() -> None:
    groups = [Group(name="g0", robots=["head"])]
    groups += [Group(name=f"g{i}", robots=[f"g{i - 1}"] * 2) for i in range(1, 100)]
    with pytest.raises(DeclarationError) as caught:
        Scene(robots=[robot("head")], groups=groups)
    assert len(caught.value.problems) == 99


def test_panel_shows_a_group_as_a_tree_with_switches_for_all_robots() -> None:
    doubles = [Double(name="goal", of="arms", joint_angles=np.zeros(6))]
    world = World(justin(doubles=doubles))
    toggles = Toggles(world)
    panel = RobotPanel(world, toggles)
    ui = ScriptedWidgets({"justin/arms/billboards": True})
    panel.build(ui)
    assert [way for way in ui.ways if way.rpartition("/")[2] not in ("joints", "sizes")] == [
        "justin", "justin/torso", "justin/head", "justin/arms", "justin/arms/left",
        "justin/arms/right", "goal", "goal/goal_left", "goal/goal_right", "Transparent doubles",
        "Scene",
    ]  # fmt: skip
    shown = {list(world.owners)[i] for i in world.joints.owner[toggles.billboards]}
    assert shown == {"left", "right"}
    panel.build(ScriptedWidgets({"justin/arrows": False}))
    robots = world.joints.owner < len(world.robots)
    assert not toggles.arrows[robots].any()
    panel.build(ScriptedWidgets({"Transparent doubles/goal##double": False}))
    assert not toggles.doubles.any()


def test_controllers_of_a_group_apply_to_its_robots() -> None:
    soft, stiff = ({"kind": "joint_impedance", "stiffness": k, "damping": 0.7} for k in (1, 2))
    free = {"kind": "gravity_compensation"}
    scenario = Scenario(
        justin(), controllers={"justin": soft, "arms": stiff, "left": free},
        targets={"arms": {"kind": "constant"}}, duration=0.1,
    )  # fmt: skip
    found = {name: getattr(each, "stiffness", None) for name, each in scenario.controllers.items()}
    assert found == {"left": None, "right": 2, "head": 1, "torso": 1}
    assert sorted(scenario.targets) == ["left", "right"]
    with pytest.raises(DeclarationError) as caught:
        Scenario(justin(), controllers={"justn": soft, "arms": {"kind": "joint_impedanc"}})
    assert [str(problem) for problem in caught.value.problems] == [
        "controllers.arms.kind: no kind 'joint_impedanc'; did you mean 'joint_impedance'?",
        "controllers.justn: no robot 'justn'; did you mean 'justin'?",
    ]


def test_group_without_data_is_reported_once_and_doubles_below() -> None:
    routes = {
        "justin.joint_angles": "udp.values0",
        "arms.torques": "more.values0",
        "goal.joint_angles": "other.values0",
    }
    scene = justin(routes, "9F", doubles=[Double(name="goal", of="arms")])
    for name in ("more", "other"):
        scene.sources[name] = {"kind": "udp", "port": 0, "structure": "6F"}
    world = World(scene)

    def written(**ages: float) -> list[str]:
        data = world.make_data()
        for name in scene.sources:
            set_source(data, world, name, received=5, age=ages.get(name, 0.1), size=72)
        Placer(world).place(data)
        buffer = Decor(world).draw(data, toggles_of(world), view_at(distance=4))
        return sorted(text for text in labels(buffer.rows[: buffer.count]) if "data" in text)

    assert written(udp=-1, other=2.0) == ["goal: no data for 2.0 s", "justin: no data yet"]
    assert written(udp=-1) == ["justin: no data yet"]
    some = written(more=2.0)  # only of the arms, so each reports it
    assert some == ["left: no data for 2.0 s", "right: no data for 2.0 s"]


def test_double_of_a_group_with_too_many_angles_is_reported_once() -> None:
    with pytest.raises(DeclarationError) as caught:
        justin(doubles=[Double(name="goal", of="arms", joint_angles=np.zeros(5))])
    assert str(caught.value) == (
        "doubles.goal.joint_angles: found values of 5 joints; expected 6 (left 3, right 3), or 4 "
        "without the coupled joints"
    )
