"""Jogging: without a screen, in a window, and the resulting gravity torques."""

from __future__ import annotations

import shlex
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from conftest import raises_with
from decor_tools import view_at
from scripted_widgets import ScriptedWidgets
from shown import Shown
from window_tools import MISSING, SIZE, Driven, screen

import sero_mj
from sero_mj.base.frames import frame, inverse, rotation_from_rpy, rpy_from_rotation
from sero_mj.data.drive.mirror import Mirror
from sero_mj.robots.assemble.gravity_torques import GravityTorques
from sero_mj.simulate.control.compiler import Compiler
from sero_mj.viewer.decor.toggles import Toggles
from sero_mj.viewer.image.scene_decor import SceneDecor
from sero_mj.viewer.session.joint_goal import JointGoal, as_command, as_python, as_toml
from sero_mj.viewer.tools.jogging import Jogging, approached

BENT = np.array([0.2, 0.6, -0.3, -1.2, 0.4, 0.8, 0.1])


def lwr_mirror(**fields: Any) -> Mirror:
    return Mirror(sero_mj.Scene(robots=[sero_mj.SerialRobot.from_model("lwr", **fields)]))


def settle(mirror: Mirror, jogging: Jogging, seconds: float = 2.0) -> None:
    for _ in range(round(60 * seconds)):
        jogging.advance(1 / 60)
        mirror.advance(0.0)


def weigh(mirror: Mirror, jogging: Jogging) -> None:
    """Waits until the gravity model is compiled."""
    end = time.monotonic() + 20
    while not mirror.data.userdata[mirror.world.flags["lwr.torques"]] > 0:
        assert time.monotonic() < end
        settle(mirror, jogging, 0.1)


def test_gravity_torques_equal_those_of_the_controller_model() -> None:
    robot = sero_mj.SerialRobot.from_model("lwr")
    model = Compiler().robot_model(robot)
    known = GravityTorques({"lwr": robot})
    for angles in (BENT, -BENT):
        model.update(angles, np.zeros(7))
        assert known.of({"lwr": angles})["lwr"] == pytest.approx(model.gravity(), abs=1e-9)


def test_carrier_holds_the_robots_mounted_on_it() -> None:
    arm = sero_mj.SerialRobot.from_model("lwr")
    finger = sero_mj.SerialRobot.from_model("hit_finger", name="finger", mount="lwr/flange")
    both = GravityTorques({"lwr": arm, "finger": finger})
    alone = GravityTorques({"lwr": arm})
    angles = {"lwr": BENT, "finger": np.zeros(finger.n)}
    more = both.of(angles)["lwr"] - alone.of({"lwr": BENT})["lwr"]
    # J^T m g by the NumPy Jacobian at the finger's center of mass.
    world = sero_mj.World(sero_mj.Scene(robots=[arm, finger]), dynamic=True)
    data = world.make_data()
    data.qpos[world.robots["lwr"].qpos] = BENT
    mujoco.mj_forward(world.model, data)
    body = world.robots["finger"].bodies[0]
    mass, centre = world.model.body_subtreemass[body], data.subtree_com[body]
    T = arm.fwd_kin_base_to_flange(BENT)
    at = arm.T_n_flange @ inverse(T) @ frame(np.eye(3), centre)
    J = arm.kinematics.jacobian(BENT, None, at, arm.flange_link)
    assert more == pytest.approx(9.80665 * mass * J[2], abs=2e-3)


def test_floating_robot_has_no_gravity_torques() -> None:
    robot = sero_mj.SerialRobot.from_model("lwr", free_base=True)
    with raises_with(
        key="robots.lwr",
        reason="joint torques cannot hold a robot with a free base against gravity",
    ):
        GravityTorques({"lwr": robot})


def test_roll_pitch_and_yaw_round_trip() -> None:
    rng = np.random.default_rng(1)
    for rpy in [*rng.uniform(-1.5, 1.5, (20, 3)), [0.3, np.pi / 2, 0.0], [0.3, -np.pi / 2, 0.0]]:
        rotation = rotation_from_rpy(np.array(rpy))
        again = rotation_from_rpy(rpy_from_rotation(rotation))
        assert again == pytest.approx(rotation, abs=1e-9)


def test_shown_angles_move_smoothly_and_arrive() -> None:
    shown, fastest = np.zeros(2), np.array([4.0, 1.0])
    wanted = np.array([1.0, 0.01])
    steps = []
    for _ in range(60):
        now = approached(shown, wanted, 1 / 60, fastest)
        steps.append(now - shown)
        shown = now
    assert shown.tolist() == wanted.tolist()
    assert np.max(steps) <= 4.0 / 60 + 1e-12
    assert np.min(steps) >= 0.0


def test_joints_stop_at_their_limits_and_report_them() -> None:
    goal = JointGoal(sero_mj.SerialRobot.from_model("lwr"), BENT)
    goal.set_joint(1, 3.0)
    assert goal.trouble == "A2 is at its limit of 120 deg"
    assert goal.angles[1] == pytest.approx(np.deg2rad(120))
    goal.set_joint(1, 0.5)
    assert goal.trouble == "" and goal.angles[1] == 0.5
    goal.set_all(np.full(7, 9.0))
    assert goal.trouble.startswith("A1 is at its limit of 170 deg, A2 is at")
    for wrong in (np.nan, np.inf):
        goal.set_joint(1, wrong)
        assert goal.trouble == "expected a finite number; the robot does not move"
        goal.move_flange(np.eye(4), frame(np.eye(3), [wrong, 0.0, 0.5]), at_once=True)
        assert (
            goal.trouble.startswith("expected a finite number") and np.isfinite(goal.angles).all()
        )
    # Typed poses out of reach change nothing.
    goal.set_all(BENT)
    goal.move_flange(np.eye(4), frame(np.eye(3), [2.0, 0, 0.3]), at_once=True)
    assert goal.angles == pytest.approx(BENT)
    assert goal.trouble.startswith("the pose is not reached (1")
    assert goal.trouble.endswith("; the robot does not move")
    assert goal.mark is not None and goal.mark[0].tolist() == [2.0, 0.0, 0.3]
    there = goal.flange(np.eye(4))
    assert goal.mark[1] == pytest.approx(there[:3, 3])
    there[:3, 3] += [0.02, -0.03, 0.01]
    goal.move_flange(np.eye(4), there, at_once=True)
    assert goal.trouble == ""
    found = goal.robot.fwd_kin_base_to_flange(goal.angles)
    assert found == pytest.approx(there, abs=1e-3)


def test_only_robots_without_data_can_be_jogged() -> None:
    def jogged(name: str) -> list[str]:
        mirror = Mirror(sero_mj.load_scene(name))
        return [*Jogging(Shown(mirror)).goals]

    assert jogged("lwr") == ["lwr"]
    assert jogged("lwr_udp") == []
    assert len(jogged("models/justin/group.toml")) > 10


def test_gravity_torques_are_shown_and_named_in_the_legend() -> None:
    mirror = lwr_mirror(show_arrows=True, show_billboards=True)
    world, toggles = mirror.world, Toggles(mirror.world)
    jogging = Jogging(Shown(mirror, toggles=toggles))
    jogging.goals["lwr"].set_all(BENT)
    settle(mirror, jogging)
    assert mirror.data.qpos == pytest.approx(BENT)
    weigh(mirror, jogging)
    settle(mirror, jogging, 0.1)
    expected = GravityTorques({"lwr": world.robots["lwr"].robot}).of({"lwr": BENT})["lwr"]
    shown = mirror.data.userdata[world.slots["lwr.torques"]]
    assert shown == pytest.approx(expected)
    assert np.abs(shown).max() > 20
    decor = SceneDecor(world, toggles)
    decor.lay_out(mirror.data, view_at())
    texts = [line for panels in decor.panels for lines in panels.texts for line in lines]
    assert b"round arrows: gravity torque of the model" in texts
    assert any(b"Nm" in text for text in texts)
    # Torques set by a program are not replaced.
    world.set_input(mirror.data, "lwr.torques", np.arange(7.0))
    settle(mirror, jogging, 0.1)
    assert mirror.data.userdata[world.slots["lwr.torques"]].tolist() == [*range(7)]
    assert not toggles.modelled.any()
    decor.lay_out(mirror.data, view_at())
    texts = [line for panels in decor.panels for lines in panels.texts for line in lines]
    assert b"round arrows: joint torque" in texts


def test_declared_torques_are_not_replaced() -> None:
    mirror = lwr_mirror(show_arrows=True, torques=[1, 2, 3, 4, 5, 6, 7])
    toggles = Toggles(mirror.world)
    jogging = Jogging(Shown(mirror, toggles=toggles))
    settle(mirror, jogging, 0.2)
    assert not toggles.modelled.any() and jogging.held._compiling is None


def test_pose_set_by_a_program_is_taken_over() -> None:
    mirror = lwr_mirror()
    jogging = Jogging(Shown(mirror))
    jogging.goals["lwr"].set_all(BENT)
    settle(mirror, jogging)
    mirror.world.set_input(mirror.data, "lwr.joint_angles", -BENT)
    settle(mirror, jogging, 0.1)
    assert mirror.data.qpos == pytest.approx(-BENT)
    assert jogging.goals["lwr"].angles == pytest.approx(-BENT)


def test_pose_that_a_program_sets_repeatedly_cannot_be_jogged() -> None:
    mirror = lwr_mirror()
    jogging = Jogging(Shown(mirror))

    def found() -> tuple[bool, bool]:
        ui = ScriptedWidgets()
        jogging.build(ui)
        return "a program controls this pose" in ui.texts(), "home" in ui.disabled

    for step in range(3):
        assert found() == (step == 2, step == 2)  # once may be a reset
        mirror.world.set_input(mirror.data, "lwr.joint_angles", BENT * (step + 1) / 3)
        settle(mirror, jogging, 0.1)
    settle(mirror, jogging, 1.0)
    assert found() == (False, False)


@pytest.mark.slow
@pytest.mark.parametrize("link", [3, 5, 7])
def test_dragged_link_follows_the_pointer_until_released(link: int) -> None:
    mirror = lwr_mirror(joint_angles=BENT)
    world, data = mirror.world, mirror.data
    mirror.advance(0.0)
    toggles = Toggles(world)
    decor = SceneDecor(world)
    jogging = Jogging(Shown(mirror, toggles=toggles, decor=decor))
    view = view_at()
    decor.lay_out(data, view)
    body = world.robots["lwr"].bodies[link]
    (x, y), _ = view.project(data.xipos[body] if data.xipos[body].any() else data.xpos[body])
    found = jogging.grab((x, y))
    assert found is not None and found[0].startswith("moving lwr/link") and not found[1]
    name, grabbed, point = jogging._dragged
    part = world.robots[name]

    def there() -> np.ndarray:
        at = part.bodies[grabbed]
        return data.xpos[at] + data.xmat[at].reshape(3, 3) @ point

    assert view.project(there())[0] == pytest.approx([x, y], abs=1.0)
    jogging.move((x + 25, y - 15))
    for _ in range(60):
        trouble = jogging.drag()
        settle(mirror, jogging, 0.05)
    assert trouble == ""
    assert view.project(there())[0] == pytest.approx([x + 25, y - 15], abs=1.5)
    jogging.move((x + 4000, y))
    for _ in range(60):
        trouble = jogging.drag()
        settle(mirror, jogging, 0.05)
    assert trouble.startswith("the pose is not reached (")
    assert toggles.handles is not None and toggles.handles.mark is not None
    low, high = part.robot.position_limits.T
    assert (data.qpos >= low - 1e-9).all() and (data.qpos <= high + 1e-9).all()
    jogging.release()
    assert toggles.handles is None and jogging.goals["lwr"].trouble == ""


def test_jogging_panel_has_limits_units_poses_and_copies() -> None:
    mirror = lwr_mirror(joint_angles=BENT)
    world = mirror.world
    jogging = Jogging(Shown(mirror))
    jogging.build(ScriptedWidgets({"##A2": 90.0, "##unit": "rad"}))
    assert jogging.goals["lwr"].angles[1] == pytest.approx(np.pi / 2)
    jogging.build(ScriptedWidgets({"##E1 typed": -0.25}))  # now in rad
    assert jogging.goals["lwr"].angles[2] == -0.25
    jogging.build(ScriptedWidgets({"##A2 typed": 9.0}))
    ui = ScriptedWidgets()
    jogging.build(ui)
    assert "A2 is at its limit of 120 deg" in ui.texts()
    jogging.build(ScriptedWidgets({"home": True}))
    settle(mirror, jogging)
    before = jogging.goals["lwr"].flange(np.eye(4))
    jogging.build(ScriptedWidgets({"##x": before[0, 3] + 0.05}))
    settle(mirror, jogging)
    moved = world.fwd_kin_base_to_flange(mirror.data, "lwr")
    assert moved[:3, 3] == pytest.approx(before[:3, 3] + [0.05, 0, 0], abs=1e-3)
    assert moved[:3, :3] == pytest.approx(before[:3, :3], abs=2e-3)
    angles = jogging.goals["lwr"].angles
    for label, text in (
        ("TOML", as_toml("lwr", angles)),
        ("Python", as_python("lwr", angles)),
        ("command", as_command(world.scene, "lwr", angles)),
    ):
        ui = ScriptedWidgets({label: True})
        jogging.build(ui)
        assert ui.copied == text


def test_copied_poses_can_be_read_back(tmp_path: Path) -> None:
    file = tmp_path / "lwr.toml"
    file.write_text(as_toml("lwr", BENT).replace("]\n", ']\nmodel = "lwr"\n', 1), "utf-8")
    assert sero_mj.load_scene(file).robots["lwr"].joint_angles == pytest.approx(BENT)
    scene = sero_mj.load_scene("lwr")
    command = shlex.split(as_command(scene, "lwr", BENT))
    assert command[:4] == ["sero-mj", "view", "lwr", "--set"]
    target, _, values = command[4].partition("=")
    assert target == "lwr.joint_angles"
    assert [float(value) for value in values.split(",")] == pytest.approx(BENT)
    assert as_python("lwr", BENT).startswith('viewer.robot("lwr").joint_angles = [0.2, 0.6,')
    own = sero_mj.load_scene(file)
    assert shlex.split(as_command(own, "lwr", BENT))[2] == str(file)


def test_branched_robots_list_their_joints_by_limb() -> None:
    from humanoid import humanoid

    mirror = Mirror(sero_mj.Scene(robots=[humanoid()], floor=False))
    jogging = Jogging(Shown(mirror))
    ui = ScriptedWidgets()
    jogging.build(ui)
    limbs = mirror.world.robots["human"].robot.limb_joints
    assert [label for kind, label in ui.built if kind == "tree"][: len(limbs)] == [
        f"{limb}##sliders" for limb in limbs
    ]


@pytest.mark.gl
@pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")
def test_sliders_and_links_move_the_robot_in_a_window(tmp_path: Path) -> None:
    settings = ("lwr.joint_angles=0,0.6,0,-1.2,0,0.8,0",)
    with screen() as display, Driven(display, tmp_path, "lwr", settings=settings) as window:
        window.key("Tab")
        window.until("w.shows_panel")
        window.until("places.get('##A2')")
        window.settle()
        left, top, right, bottom = window.ask("places['##A2']")
        middle, y = round((left + right) / 2), round((top + bottom) / 2)
        window.tool("mousemove", middle + 15, y, "mousedown", 1)
        window.settle()
        window.tool("mousemove", middle - 10, y)
        window.settle()
        window.tool("mouseup", 1)
        share = -10 / (right - left - 2 * 7)  # the grab has a width
        window.until(f"abs(w.data.qpos[1] - {share * np.deg2rad(240)}) < 0.15")
        # A typed value.
        x, y = window.middle("##A3 typed")
        window.tool("mousemove", round(x), round(y), "click", 1)
        window.settle()
        window.tool("key", "ctrl+a")
        window.tool("key", "minus", "9", "0")
        window.settle()
        window.tool("key", "Return")
        window.until("abs(w.data.qpos[3] + np.pi / 2) < 1e-6")
        assert not window.ask("w.toggles.arrows.any()")
        # A link, which the panel would cover.
        window.key("Tab")
        window.until("not w.shows_panel")
        window.settle()
        place = (
            "[*w.decor.view.project(w.data.xpos[w.world.robots['lwr'].bodies[5]])[0].tolist(), "
            "w.decor.rect.bottom]"
        )
        x, y, bottom = window.ask(place)
        before = window.ask("w.data.qpos.tolist()")
        window.tool("mousemove", round(x), round(SIZE[1] - bottom - y), "keydown", "Control_L")
        window.tool("mousedown", 1, "mousemove_relative", 20, 10, "mousemove_relative", 30, 5)
        window.until("'moving lwr/' in w.notice.text")
        window.settle()
        window.tool("mouseup", 1, "keyup", "Control_L")
        after = window.ask("w.data.qpos.tolist()")
        assert np.abs(np.subtract(after, before)).max() > 0.02
        moved = window.ask(place)
        assert np.linalg.norm(np.subtract(moved, [x, y, bottom])[:2]) > 20
        camera = window.ask("w.navigator.following")
        assert camera is None


@pytest.mark.thorough
@pytest.mark.gl
@pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")
def test_pose_is_undone_and_copied_with_its_gravity_torques(tmp_path: Path) -> None:
    with screen() as display, Driven(display, tmp_path, "lwr") as window:
        window.ask("w.tools['jogging'].goals['lwr'].set_joint(1, 0.5)")
        window.until("abs(w.data.qpos[1] - 0.5) < 1e-9")
        window.until("w.tools['undo'].undo.count == 1 and w.tools['undo'].undo.is_settled")
        window.key("a")
        window.until("w.toggles.modelled.all()")
        words = window.ask("w.render_words()")
        torques = next(word for word in words if word.startswith("lwr.torques="))
        found = [float(each) for each in torques.partition("=")[2].split(",")]
        held = window.ask("w.data.userdata[w.world.slots['lwr.torques']]")
        assert found == pytest.approx(held, abs=1e-4)
        assert abs(found[1]) > 5.0
        assert "modelled=1111111" in words
        window.until("w.tools['undo'].undo.count == 2 and w.tools['undo'].undo.is_settled")
        window.key("ctrl+z")
        window.until("not w.toggles.arrows.any()")
        assert window.ask("w.data.qpos[1]") == 0.5
        window.key("ctrl+z")
        window.until("w.data.qpos[1] == 0.0")
        window.key("ctrl+y")
        window.until("w.data.qpos[1] == 0.5")
