"""Live simulation of robots: controllers, gains and targets that change while it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from decor_tools import view_at
from scripted_widgets import ScriptedWidgets
from shown import Shown

import sero_mj
from sero_mj.base.errors import DeclarationError, SimulationError
from sero_mj.base.frames import frame, rotation_angle, rotation_from_rpy
from sero_mj.cli import main
from sero_mj.data.drive.mirror import Mirror
from sero_mj.load import load_scene
from sero_mj.simulate import endless_run
from sero_mj.simulate.endless_run import bent_pose, endless_scene
from sero_mj.simulate.runs.run_recording import read_run
from sero_mj.simulate.tools.pulling import Pulling
from sero_mj.simulate.tools.steering import Steering
from sero_mj.simulate.tools.steering_panel import SteeringPanel
from sero_mj.viewer.decor.handles import CUBE, HANDLE_NAMES
from sero_mj.viewer.decor.toggles import Toggles
from sero_mj.viewer.image.scene_decor import SceneDecor
from sero_mj.viewer.session.clock import Clock
from sero_mj.viewer.tools.handle_drag import dragged

BENT = np.array([0.2, 0.6, -0.3, -1.2, 0.4, 0.8, 0.1])


def lwr_scene(**fields: Any) -> sero_mj.Scene:
    robot = sero_mj.SerialRobot.from_model("lwr", joint_angles=BENT, **fields)
    return sero_mj.Scene(robots=[robot], name="lwr")


class Played:
    """A live simulation of a scene, with the parts of a viewer it needs."""

    def __init__(self, control: str = "joint", scene: sero_mj.Scene | None = None) -> None:
        self.mirror = Mirror(endless_scene(scene or lwr_scene(), control))  # type: ignore[arg-type]
        self.mirror.open()
        self.world, self.data = self.mirror.world, self.mirror.data
        self.clock, self.toggles = Clock(self.mirror), Toggles(self.world)
        self.source: Any = self.mirror.sources["simulation"]
        self.run: Any = self.source.run
        self.decor = SceneDecor(self.world, self.toggles)
        self.shown = Shown(self.mirror, toggles=self.toggles, clock=self.clock, decor=self.decor)
        self.steering = Steering(self.shown)
        self.go(0.02)

    def go(self, seconds: float) -> None:
        for _ in range(max(round(seconds / 0.02), 1)):
            self.steering.advance(0.02)
            self.clock.advance(0.02)

    @property
    def lwr(self) -> Any:
        return self.steering.robots["lwr"]

    def signal(self, name: str) -> np.ndarray:
        return self.run.log.of("lwr", name)


@pytest.mark.parametrize("control", ["joint", "cartesian"])
def test_robot_follows_its_target_smoothly(control: str) -> None:
    played = Played(control)
    wanted = BENT + np.array([0.3, -0.2, 0.1, 0.4, -0.3, 0.2, 0.5])
    played.steering.goals["lwr"].set_all(wanted)
    played.go(3.0)
    assert played.source.error is None
    assert played.lwr.measured == pytest.approx(wanted, abs=2e-3)
    target = played.signal("target_angles")
    assert target[-1] == pytest.approx(wanted)
    steps = np.abs(np.diff(target, axis=0)).max(axis=0)
    limits = played.lwr.robot.velocity_limits
    assert (steps <= 0.7 * limits * 1e-3 + 1e-12).all()  # it never jumps
    shown = played.data.userdata[played.world.slots["lwr_target.joint_angles"]]
    assert shown == pytest.approx(wanted)
    rows = played.run.rows[: played.run.step + 1]
    pose = rows[-1, played.run.layout.columns["lwr_target_pose"]].reshape(4, 4)
    robot = played.lwr.robot
    assert pose == pytest.approx(robot.base_frame @ robot.fwd_kin_base_to_flange(wanted), abs=1e-9)


def test_controllers_change_without_a_jump() -> None:
    played = Played("gravity")
    played.go(0.2)
    before = played.signal("commanded_torques")[-1].copy()
    # Moved while it is free, when no controller commands a path.
    held = played.run.plant.push("lwr/flange", force=[0.0, 25.0, 10.0])
    played.go(0.2)
    played.run.plant.release(held)
    played.go(1.0)
    moved = played.lwr.measured.copy()
    assert np.abs(moved - BENT).max() > 0.05
    assert played.signal("target_angles")[-1] == pytest.approx(moved, abs=3e-3)

    def jump(control: str) -> float:
        """Returns the change of the torques when the controller is changed, Nm."""
        row = played.run.step
        assert played.steering.choose("lwr", control).startswith("lwr: ")
        played.go(0.02)
        torques = played.signal("commanded_torques")
        return float(np.abs(torques[row + 1] - torques[row]).max())

    assert np.abs(played.signal("joint_velocities")[-1]).max() > 0.1
    assert jump("joint") < 1.0  # while the robot and its target move
    played.go(1.5)
    moved = played.lwr.measured.copy()
    for control in ("cartesian", "gravity", "joint"):
        assert jump(control) < 0.1
        played.go(0.3)
    played.go(1.0)
    assert played.lwr.measured == pytest.approx(moved, abs=0.03)
    assert np.abs(before).max() > 20


def test_compliance_under_a_force_matches_the_stiffness() -> None:
    played = Played("joint")
    stiffness = np.array([900.0, 900, 500, 500, 500, 200, 200])
    assert played.lwr.change({"stiffness": stiffness}, str) == ""
    force = np.array([0.0, 30.0, -40.0])
    played.run.plant.push("lwr/flange", force=force)
    played.go(3.0)
    robot = played.lwr.robot
    found = played.lwr.measured
    J = robot.kinematics.jacobian(found, robot.base_frame, robot.T_n_flange, robot.flange_link)
    expected = J[:3].T @ force / stiffness
    assert found - BENT == pytest.approx(expected, rel=0.05, abs=2e-3)
    assert np.abs(expected).max() > 0.02


def test_gains_unstable_at_the_step_are_rejected_with_the_largest_stable_one() -> None:
    finger = sero_mj.SerialRobot.from_model("hit_finger")
    finger = finger.model_copy(update={"torque_limits": None})
    played = Played("joint", sero_mj.Scene(robots=[finger], name="finger"))
    (robot,) = played.steering.robots.values()
    before = robot.controllers["joint_impedance"].stiffness.copy()
    texts = []

    def text(values: Any) -> str:
        texts.append(float(values["stiffness"].max()))
        return f"{texts[-1]:.4g} Nm/rad"

    why = robot.change({"stiffness": np.full(finger.n, 5000.0)}, text)
    assert why.startswith("refused: joint ") and "with a time step of 1 ms" in why
    assert why.endswith(f" is {texts[-1]:.4g} Nm/rad")
    assert robot.controllers["joint_impedance"].stiffness.tolist() == before.tolist()
    share = (texts[-1] - before.max()) / (5000.0 - before.max())
    most = before + share * (5000.0 - before)
    assert robot.change({"stiffness": most}, text) == ""
    assert robot.change({"stiffness": before + 1.05 * share * (5000.0 - before)}, text) != ""
    assert robot.change({"damping": np.array([9.0])}, lambda v: "x").startswith("refused: found 9;")
    nothing = robot.change({"stiffness": np.full(finger.n, np.nan)}, text)
    assert nothing.startswith("refused: ") and "At most" not in nothing
    played.go(0.2)
    assert played.source.error is None


def test_gains_take_effect_at_once() -> None:
    played = Played("cartesian")
    push = played.run.plant.push("lwr/flange", force=[0.0, 0.0, -40.0])
    ways = []
    for stiffness in (2000.0, 500.0):
        gains = np.diag([stiffness] * 3 + [100.0] * 3)
        assert played.lwr.change({"stiffness": gains}, str) == ""
        played.go(2.5)
        there = played.run.plant.flange("lwr")[2, 3]
        goal = played.steering.goals["lwr"].flange(played.steering.base("lwr"))[2, 3]
        ways.append(goal - there)
    played.run.plant.release(push)
    assert ways == pytest.approx([40 / 2000, 40 / 500], rel=0.05)


def test_live_simulation_has_no_end_and_a_bounded_past(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(endless_run, "KEPT", 0.6)
    monkeypatch.setattr(endless_run, "_LOG_DURATION", 0.9)
    played = Played("joint")
    size = played.run.rows.nbytes
    assert played.source.end is None and played.source.about == "simulation of lwr"
    held = played.run.plant.push("lwr/flange", force=[0.0, 25.0, 0.0])
    played.go(2.0)
    played.run.plant.release(held)
    now = played.clock.time
    assert now == pytest.approx(2.0, abs=0.05)
    begin, newest = played.clock.begin, played.clock.end
    assert newest == pytest.approx(now, abs=1e-9)
    assert 0.6 <= newest - begin <= 0.9
    assert played.run.rows.nbytes == size
    rows = played.run.rows[: played.run.step + 1]
    assert np.diff(rows[:, 0]) == pytest.approx(1e-3)
    speeds = np.diff(played.signal("joint_angles"), axis=0) / 1e-3
    # No discontinuity.
    assert speeds == pytest.approx(played.signal("joint_velocities")[1:], abs=0.02)
    # The past can be seen, and not before what is kept; then it continues from the newest state.
    then = begin + 0.2
    played.clock.seek(then)
    played.clock.is_paused = True
    played.go(0.02)
    row = round(0.2 / 1e-3)
    assert played.data.qpos == pytest.approx(
        rows[row, played.run.layout.columns["lwr_joint_angles"]]
    )
    assert played.steering.is_past
    played.clock.seek(0.0)
    assert played.clock.time == pytest.approx(begin)
    assert played.clock.go_live() == "continues from the newest state"
    played.go(0.1)
    assert played.clock.time > newest and not played.steering.is_past


def test_pushes_are_stored_when_the_log_is_cut(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(endless_run, "KEPT", 0.6)
    monkeypatch.setattr(endless_run, "_LOG_DURATION", 0.9)
    played = Played("joint")
    hand = played.run.drag_force
    played.shown.folder = tmp_path
    keep = Pulling(played.shown).actions()["keep"]
    hand.grab("lwr/link5", np.zeros(3))
    hand.target = hand.place + 0.1 * np.eye(3)[1]
    played.go(2.0)
    (pull,) = hand.pulls
    rows = played.run.rows[: played.run.step + 1]
    logged = rows[:, played.run.layout.columns["by_hand_force"]]
    assert pull.first + len(pull.forces) == len(rows) - 1
    assert np.array(pull.forces) == pytest.approx(logged[pull.first : -1])
    assert np.linalg.norm(logged[-1]) > 1
    assert keep() == "saved lwr.mcap; sero-mj plot lwr.mcap plots it"
    kept = read_run(tmp_path / "lwr.mcap")
    assert len(kept.times) == len(rows)
    assert kept.times[-1] - kept.times[0] == pytest.approx(rows[-1, 0] - rows[0, 0])
    said = keep()
    assert said is not None and said.startswith("saved lwr_2.mcap")


def test_simulation_restarts_after_an_error() -> None:
    played = Played("joint")
    played.lwr.change({"damping": np.array([0.5])}, str)
    played.source._error = SimulationError(0.1, "lwr/A2", "it runs away")
    messages: list[str] = []
    panel = SteeringPanel(played.steering, messages.append)
    ui = ScriptedWidgets()
    panel.build(ui)
    assert any(t.startswith("stopped: ") and "it runs away" in t for t in ui.texts())
    panel.build(ScriptedWidgets({"restart": True}))
    assert messages == ["restarted from the initial pose"]
    played.go(0.5)
    assert played.source.error is None and played.clock.time == pytest.approx(0.5, abs=0.05)
    assert played.lwr.control == "joint_impedance"
    assert played.lwr.controller.damping.tolist() == [0.5]
    assert played.lwr.measured == pytest.approx(BENT, abs=1e-3)


def test_unsimulatable_scene_reports_why() -> None:
    scene = lwr_scene(position_limits=[[-0.1, 0.1]] * 7)
    with pytest.raises(DeclarationError, match=r"joint A1 starts at 11.46 deg"):
        endless_scene(scene)


def test_scene_of_a_scenario_is_simulated_live() -> None:
    played = Played("joint", sero_mj.load_scene("impedance_push"))
    assert [*played.world.doubles] == ["lwr_target"] and [*played.world.scene.arrows] == ["by_hand"]
    assert played.source.about == "simulation of impedance_push"
    assert played.run.scenario.disturbances == {}


def test_two_robots_have_separate_targets() -> None:
    robots = [
        sero_mj.SerialRobot.from_model(
            "lwr", name=n, base_frame={"xyz": [0, y, 0]}, joint_angles=BENT
        )
        for n, y in (("left", 0.0), ("right", 1.0))
    ]
    played = Played("joint", sero_mj.Scene(robots=robots, name="two"))
    played.steering.choose("right", "gravity_compensation")
    played.steering.goals["left"].set_joint(0, 0.5)
    played.go(2.0)
    left, right = (played.steering.robots[name].measured for name in ("left", "right"))
    assert left[0] == pytest.approx(0.5, abs=2e-3)
    assert right == pytest.approx(BENT, abs=1e-3)


def test_panel_changes_controllers_and_gains_and_reports() -> None:
    played = Played("joint")
    messages: list[str] = []
    panel = SteeringPanel(played.steering, messages.append)
    first = played.lwr.controllers["joint_impedance"].stiffness.copy()
    panel.build(ScriptedWidgets({"stiffness": 50.0, "damping": 1.0}))
    gains = played.lwr.controllers["joint_impedance"]
    assert gains.stiffness == pytest.approx(0.5 * first) and gains.damping.tolist() == [1.0]
    panel.build(ScriptedWidgets({"A2": 700.0}))
    assert played.lwr.controllers["joint_impedance"].stiffness[1] == 700.0
    panel.build(ScriptedWidgets({"A2": 9000.0}))
    ui = ScriptedWidgets()
    panel.build(ui)
    (text,) = [each for each in ui.texts() if each.startswith("refused: ")]
    assert text.startswith("refused: found 9000")
    assert "largest stable value" in text
    panel.build(ScriptedWidgets({"##control": "Cartesian impedance"}))
    assert messages == ["lwr: Cartesian impedance"] and played.lwr.control == "cartesian_impedance"
    for label, value in (("stiffness", 800.0), ("rotational", 40.0), ("null space", 25.0)):
        panel.build(ScriptedWidgets({label: value}))
    gains = played.lwr.controllers["cartesian_impedance"]
    assert np.diagonal(gains.stiffness).tolist() == [800.0] * 3 + [40.0] * 3
    assert gains.nullspace_stiffness.tolist() == [25.0]
    panel.build(ScriptedWidgets({"##A1": 30.0}))
    assert played.steering.goals["lwr"].angles[0] == pytest.approx(np.deg2rad(30))
    panel.build(ScriptedWidgets({"move target to robot": True}))
    assert played.steering.goals["lwr"].angles == pytest.approx(played.lwr.measured)
    panel.build(ScriptedWidgets({"##control": "gravity compensation"}))
    panel.build(ScriptedWidgets({"damping": 3.0}))
    assert played.lwr.controllers["gravity_compensation"].damping.tolist() == [3.0]


POSE = frame(rotation_from_rpy(np.array([-1.5, -0.7, 0.0])), np.array([0.1, 0.05, 0.7]))


@pytest.mark.parametrize("handle", range(7))
def test_handles_follow_the_pointer(handle: int) -> None:
    view = view_at()
    name = HANDLE_NAMES[handle]
    if handle == CUBE:
        moved = POSE.copy()
        moved[:3, 3] += 0.08 * view.right - 0.05 * view.up
        point, after = POSE[:3, 3], moved[:3, 3]
    elif handle < 3:
        moved = POSE.copy()
        moved[:3, 3] += 0.07 * POSE[:3, handle]
        point, after = POSE[:3, 3] + 0.1 * POSE[:3, handle], moved[:3, 3] + 0.1 * POSE[:3, handle]
    else:
        k = handle - 3
        turn = rotation_from_rpy(0.4 * np.eye(3)[k])
        moved = POSE @ frame(turn)
        arm = 0.1 * np.eye(3)[(k + 1) % 3]
        point, after = POSE[:3, :3] @ arm + POSE[:3, 3], moved[:3, :3] @ arm + POSE[:3, 3]
    begin, now = (tuple(view.project(each)[0].tolist()) for each in (point, after))
    found = dragged(POSE, handle, view, begin, now)
    assert found == pytest.approx(moved, abs=1e-9), name


def test_ring_seen_from_the_side_rotates_along_its_edge() -> None:
    view = view_at(azimuth=0.0)
    pose = frame(np.eye(3), np.array([0.0, 0.0, 0.6]))
    x, y = view.project(pose[:3, 3])[0].tolist()
    found = dragged(pose, 5, view, (x, y), (x + 40, y))  # about z, level
    assert rotation_angle(found[:3, :3]) > 0.2
    assert found[1, 0] > 0  # the near side moves right: a right-handed rotation about z
    back = dragged(pose, 5, view, (x, y), (x - 40, y))
    assert back[1, 0] == pytest.approx(-found[1, 0])


def test_dragged_handle_moves_the_target_and_limits_are_shown() -> None:
    played = Played("cartesian")
    view = view_at()
    played.steering.advance(0.02)
    played.decor.lay_out(played.data, view)
    handles = played.toggles.handles
    assert handles is not None and handles.pose is not None
    start = handles.pose.copy()
    rows = played.decor.buffer.rows[: played.decor.buffer.count]
    kinds = played.decor.buffer.kinds[: played.decor.buffer.count]
    items = played.decor.buffer.items[: played.decor.buffer.count]
    shaft, _ = np.flatnonzero((kinds == 8) & (items == 0))
    tip = rows["pos"][shaft] + 0.08 * rows["mat"][shaft][:, 2]
    at = tuple(view.project(tip.astype(float))[0].tolist())
    assert played.steering.hover(at)
    assert played.steering.grab_handle(at) == ("", False)
    wanted = tip + 0.05 * rows["mat"][shaft][:, 2]
    played.steering.move(tuple(view.project(wanted.astype(float))[0].tolist()))
    for _ in range(4):
        assert played.steering.drag() == ""
    goal = played.steering.goals["lwr"]
    pose = goal.flange(played.steering.base("lwr"))
    assert pose[:3, 3] - start[:3, 3] == pytest.approx(0.05 * start[:3, 0], abs=2e-3)
    assert pose[:3, :3] == pytest.approx(start[:3, :3], abs=3e-3)
    # Far away: it stops, reports why, and shows the requested pose.
    far = tip + 3.0 * rows["mat"][shaft][:, 2]
    played.steering.move(tuple(view.project(far.astype(float))[0].tolist()))
    for _ in range(40):
        trouble = played.steering.drag()
    assert trouble.startswith("the pose is not reached (")
    played.steering.advance(0.02)
    assert played.toggles.handles.mark is not None
    low, high = goal.robot.position_limits.T
    assert (goal.angles >= low).all() and (goal.angles <= high).all()
    played.steering.release()
    played.go(2.0)
    assert played.source.error is None
    assert played.toggles.handles.mark is None
    played.steering.choose("lwr", "gravity_compensation")
    played.steering.advance(0.02)
    assert played.toggles.handles is None


def test_links_of_a_target_can_be_dragged_if_it_is_apart_from_the_robot() -> None:
    played = Played("joint")
    view = view_at()
    played.decor.lay_out(played.data, view)
    double = played.world.doubles["lwr_target"]
    there = played.data.xpos[played.world.robots["lwr"].bodies[6]]
    at = tuple(view.project(there)[0].tolist())
    assert played.steering.grab(at) is None  # this is the robot's link, which is pulled
    played.run.plant.push("lwr/flange", force=[0.0, 60.0, -150.0])
    played.go(2.0)
    played.decor.lay_out(played.data, view)
    goal = played.steering.goals["lwr"]
    assert goal.angles == pytest.approx(BENT)  # the robot yields, its target does not
    link = played.data.xpos[double.bodies[0][6]]
    assert np.linalg.norm(link - played.data.xpos[played.world.robots["lwr"].bodies[6]]) > 0.1
    at = tuple(view.project(link)[0].tolist())
    found = played.steering.grab(at)
    assert found is not None and found[0].startswith("moves lwr_target/link")
    played.steering.move((at[0] + 30.0, at[1] + 20.0))
    for _ in range(20):
        assert played.steering.drag() == ""
    played.steering.release()
    assert np.abs(goal.angles - BENT).max() > 0.02
    played.go(1.0)
    assert played.signal("target_angles")[-1] == pytest.approx(goal.angles)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--control", "joint"], "--control joint needs --simulate"),
        (["--simulate", "--replay", "x.mcap"], "--simulate cannot be combined with --replay"),
    ],
)
def test_incompatible_options_are_rejected(
    options: list[str], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["view", "lwr", "--web", *options])
    assert why in capsys.readouterr().err


@pytest.mark.parametrize("name", ["lwr", "panda"])
def test_arm_starts_in_a_pose_that_can_move_and_is_loaded(name: str) -> None:
    robot = sero_mj.SerialRobot.from_model(name)
    if name == "panda":  # as in a URDF: no pose, and limits that exclude zero
        robot = robot.model_copy(update={"joint_angles": None})
    q = bent_pose(robot)
    lower, upper = robot.position_limits.T
    assert (q >= lower).all() and (q <= upper).all()
    J = robot.kinematics.jacobian(q, None, robot.T_n_flange)
    J[:3] /= robot.reach
    values = np.linalg.svd(J, compute_uv=False)
    assert values[-1] / values[0] > 0.05  # below 0.03 counts as singular
    x, _, z = robot.fwd_kin_base_to_flange(q)[:3, 3] / robot.reach
    assert x > 0.2 and 0.2 < z < 0.6
    scene = endless_scene(sero_mj.Scene(robots=[robot], floor=False))
    run = scene.sources["simulation"].run
    mujoco.mj_forward(run.plant.model, run.plant.data)
    assert (np.abs(run.plant.data.qfrc_bias) / robot.torque_limits).max() > 0.05


def test_declared_poses_and_robots_that_are_not_arms_are_unchanged() -> None:
    declared = sero_mj.SerialRobot.from_model("lwr", joint_angles=np.zeros(7))
    assert bent_pose(declared).tolist() == [0.0] * 7
    torso = sero_mj.SerialRobot.from_model("justin_torso")
    assert bent_pose(torso).tolist() == torso.home.tolist()


@pytest.mark.parametrize("name", ["hit_hand2", "dlr_hand2"])
def test_hand_simulated_alone_touches_nothing_and_does_not_move(name: str) -> None:
    run = endless_scene(load_scene(name, by_hand=True)).sources["simulation"].run
    mujoco.mj_forward(run.plant.model, run.plant.data)
    assert run.plant.data.ncon == 0
    run.advance(300)
    assert np.abs(run.plant.data.qvel).max() < 0.5
