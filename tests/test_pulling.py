"""Simulated robots that are pulled by hand: force, spring, and saved pushes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import free_udp_port, raises_with
from shown import Shown
from window_tools import MISSING, Driven, screen

from sero_mj import Scene, SerialRobot, UdpReceiver
from sero_mj.base.errors import DeclarationError, UsageError
from sero_mj.data.drive.mirror import Mirror
from sero_mj.load import load_scene
from sero_mj.simulate.disturbances import Force
from sero_mj.simulate.drag_force import LIMIT
from sero_mj.simulate.runs.run_recording import read_run
from sero_mj.simulate.save_pushes import save_pushes
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation
from sero_mj.simulate.tools.pulling import Pulling, target_of
from sero_mj.viewer.decor.image_view import ImageView
from sero_mj.viewer.image.render import HeadlessRenderer
from sero_mj.viewer.session.clock import Clock

_SIGNALS = ("actual_angles", "joint_angles", "torques", "external_torques", "commanded_torques")


def pushed(name: str = "impedance_push", **settings: Any) -> Simulation:
    overrides = {key.replace("__", "."): value for key, value in settings.items()}
    return Simulation(read_scenario(name, overrides), by_hand=True)


def pull(simulation: Simulation, frame: str, by: list[float], steps: int) -> None:
    simulation.drag_force.grab(frame, np.array([0.02, -0.03, 0.05]))  # type: ignore[union-attr]
    simulation.drag_force.target = simulation.drag_force.target + by  # type: ignore[union-attr]
    simulation.advance(simulation.step + steps)


def point_jacobian(angles: np.ndarray, frame: str, point: np.ndarray) -> np.ndarray:
    """Returns the Jacobian of a point of the LWR by central differences of the DH table, (3, 7)."""
    robot = read_scenario("impedance_push").scene.robots["lwr"]
    link = int(frame.removeprefix("lwr/link"))

    def place(q: np.ndarray) -> np.ndarray:
        return np.asarray((robot.kinematics.frames(q)[link] @ np.append(point, 1.0))[:3])

    step = 1e-6 * np.eye(7)
    return np.stack([(place(angles + e) - place(angles - e)) / 2e-6 for e in step], axis=1)


def test_joint_torques_at_rest_hold_the_force_by_the_transposed_jacobian() -> None:
    simulation = pushed()
    simulation.advance(900)
    before = simulation.log.of("lwr", "torques")[-1].copy()
    simulation = pushed(disturbances__push__begin=4.9, disturbances__push__end=4.95)
    pull(simulation, "lwr/link6", [0.12, -0.15, 0.1], 4000)
    log, hand = simulation.log, simulation.drag_force
    assert hand is not None
    assert np.abs(log.of("lwr", "actual_velocities")[-1]).max() < 1e-5
    assert 60 < np.linalg.norm(hand.force) < LIMIT
    J = point_jacobian(log.of("lwr", "actual_angles")[-1], "lwr/link6", hand.pulls[0].point)
    found = log.of("lwr", "external_torques")[-1]
    assert np.linalg.norm(found - J.T @ hand.force) < 0.05 * np.linalg.norm(J.T @ hand.force)
    # The force is the spring's, and the joints carry it: their torques differ.
    assert hand.force == pytest.approx(hand.stiffness * (hand.target - hand.place), abs=0.1)
    assert np.abs(log.of("lwr", "torques")[-1] - before).max() > 5
    # The log contains the force and the point where it acted.
    assert log.signals["by_hand_force"][-1] == pytest.approx(hand.force)
    assert log.signals["by_hand_frame"][-1][:3, 3] == pytest.approx(hand.place)


def test_pull_does_not_oscillate_and_is_limited() -> None:
    simulation = pushed("hand_guiding")  # gravity compensation: nothing else pulls back
    pull(simulation, "lwr/link5", [0.0, 0.1, 0.0], 3000)
    assert simulation.drag_force is not None
    y = simulation.log.signals["by_hand_frame"][1:, 1, 3]
    overshoot = (y.max() - y[0]) / (simulation.drag_force.target[1] - y[0])
    assert (y[-1] - y[0]) / 0.1 > 0.8
    assert overshoot < 1.25
    simulation = pushed()
    simulation.drag_force.stiffness = 5000.0  # type: ignore[union-attr]
    pull(simulation, "lwr/flange", [0.0, 0.4, 0.0], 100)
    sizes = np.linalg.norm(simulation.log.signals["by_hand_force"], axis=1)
    assert sizes.max() == pytest.approx(LIMIT, abs=1e-2)


@pytest.mark.parametrize("timestep", [0.001, 0.02])
def test_stiffness_and_damping_are_stable_at_the_time_step(timestep: float) -> None:
    hand = pushed(run__timestep=timestep, run__physics_timestep=0.001).drag_force
    assert hand is not None
    hand.stiffness = 5000.0
    for mass in (0.05, 1.0, 30.0):
        stiffness, damping = hand.gains(mass)
        # The explicit step of mass, spring and damper: all eigenvalues are inside the unit circle.
        A = np.array([[1, timestep], [0, 1]]) + np.outer(
            [timestep, 1], [-stiffness * timestep / mass, -damping * timestep / mass]
        )
        assert np.abs(np.linalg.eigvals(A)).max() < 1


def test_saved_pushes_repeat_the_run_bit_for_bit(tmp_path: Path) -> None:
    simulation = pushed(lwr__show_axes=True, controllers__lwr__damping=0.6)
    for begin, frame in ((100, "lwr/link4"), (990, "lwr/flange"), (1010, "lwr/link3")):
        simulation.advance(begin)  # at 1.0 s the scenario begins its own push
        simulation.drag_force.release()  # type: ignore[union-attr]
        pull(simulation, frame, [0.05, -0.2, 0.1], 5)
    simulation.advance(1300)
    simulation.drag_force.release()  # type: ignore[union-attr]
    simulation.advance(1500)
    path = save_pushes(simulation, tmp_path)
    assert path == tmp_path / "impedance_push_pushed.toml"
    scenario = read_scenario(path)
    assert scenario.scene.robots["lwr"].show_axes
    assert [*scenario.disturbances] == ["push", "push1", "push2", "push3"]
    again = Simulation(scenario)
    again.advance(1500)
    for signal in _SIGNALS:
        assert np.array_equal(again.log.of("lwr", signal), simulation.log.of("lwr", signal)), signal
    # The recording beside it contains the run with the pull.
    recorded = read_run(path.with_suffix(".mcap"))
    assert np.array_equal(recorded.of("lwr", "torques"), simulation.log.of("lwr", "torques"))
    assert np.array_equal(
        recorded.signals["by_hand_force"], simulation.log.signals["by_hand_force"]
    )
    # A second save has another name, and a pushed scenario can be pushed again.
    assert save_pushes(simulation, tmp_path).name == "impedance_push_pushed_2.toml"
    twice = pushed(str(path))
    pull(twice, "lwr/link2", [0.0, 0.1, 0.0], 50)
    thrice = read_scenario(save_pushes(twice, tmp_path))
    assert [*thrice.disturbances] == ["push", "push1", "push2", "push3", "push4"]


def test_invalid_saves_and_grabs_are_rejected(tmp_path: Path) -> None:
    simulation = pushed()
    with raises_with(UsageError, reason="there are no pushes to save. Hold Ctrl and drag a link"):
        save_pushes(simulation, tmp_path)
    assert simulation.drag_force is not None
    with raises_with(UsageError, reason="lwr/base cannot be pulled: it has no degree of freedom"):
        simulation.drag_force.grab("lwr/base", np.zeros(3))
    pull(simulation, "lwr/link4", [0.0, 0.1, 0.0], 10)
    simulation.scenario.file = None
    with raises_with(
        UsageError,
        reason="the scenario was made in Python; only a scenario file can be extended",
    ):
        save_pushes(simulation, tmp_path)
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("extends = 3", "extends: found 3; expected the name or file of a scenario"),
        ('extends = "impedance_pusch"', "did you mean 'impedance_push'"),
        ('extends = "own.toml"', "extends: `extends` is circular: own.toml extends this file"),
        ('extends = "impedance_push"\nset = 3', "set: found 3; expected a table"),
        ('extends = "impedance_push"\n[robots.b]\nmodel = "lwr"',
         "own.toml:2: robots can only be changed in [set] of a scenario that extends "),
        ('extends = "impedance_push"\n[disturbances.a]\nkind = "force"\nat = "lwr/flansch"\n'
         "force = [0, 0, 1]", "own.toml:4: disturbances.a.at: no frame 'lwr/flansch'"),
        ('[set]\n"run.seed" = 3\n[run]', "set requires `extends`"),
    ],
)  # fmt: skip
def test_errors_in_a_scenario_that_extends_another_are_reported(
    tmp_path: Path, text: str, expected: str
) -> None:
    (tmp_path / "own.toml").write_text(text)
    with pytest.raises(DeclarationError) as found:
        read_scenario(tmp_path / "own.toml")
    assert expected in str(found.value)


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"force": [0, 0, 1]}, "samples cannot be combined with force"),
        ({"end": None}, "end is required"),
        (
            {"samples": [[0.1, 0, 0, 1]]},
            "samples: found times [0.1]; expected increasing times that start at 0",
        ),
        ({"samples": [[0.0, 0, 0], [1, 1, 1]]}, "found 2 x 3; expected n x 4 numbers"),
    ],
)
def test_force_samples_are_checked(fields: dict[str, Any], expected: str) -> None:
    good = {"at": "lwr/flange", "begin": 1.0, "end": 2.0, "samples": [[0.0, 0, 0, 1]]}
    with pytest.raises(DeclarationError) as found:
        Force(**{**good, **fields})
    assert expected in str(found.value)


def test_force_samples_hold_until_the_next_and_the_end() -> None:
    force = Force(at="a/b", begin=1.0, end=1.3, samples=[[0.0, 1, 0, 0], [0.2, 0, 2, 0]])
    times = [0.9, 1.0, 1.1, 1.2, 1.25, 1.3, 2.0]
    found = force.at_times(np.array(times))
    assert found[:, 0, 0].tolist() == [0, 1, 1, 0, 0, 0, 0]
    assert found[:, 0, 1].tolist() == [0, 0, 0, 2, 2, 0, 0]
    assert not found[:, 1].any()


def test_pointer_pulls_in_the_image_plane_through_the_point() -> None:
    forward = np.array([0.0, 0.6, -0.8])
    view = ImageView(
        position=np.array([1.0, -2.0, 3.0]), right=np.array([1.0, 0, 0]),
        up=np.array([0, 0.8, 0.6]), forward=forward, tan_half_fovy=0.4, near=0.01, width=640,
        height=480,
    )  # fmt: skip
    point = np.array([0.9, -0.6, 1.1])
    pixel, _ = view.project(point)
    moved = pixel + np.array([50.0, -20.0])
    target = target_of(view.position, forward, point, view.at(moved, 1.0))
    assert view.project(target)[0] == pytest.approx(moved)
    assert (target - point) @ forward == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("is_live", [False, True])
def test_live_sources_have_no_action_to_save_pushes(is_live: bool) -> None:
    robot = SerialRobot.from_model("lwr", name="lwr")
    sources = {"udp": UdpReceiver(structure="7F", udpport=free_udp_port())}
    scene = Scene(robots=[robot], sources=sources, routes={"lwr.joint_angles": "udp.values0"})
    with Mirror(scene if is_live else Scene(robots=[robot])) as mirror:
        assert ("keep" in Pulling(Shown(mirror, clock=Clock(mirror))).actions()) != is_live


@pytest.mark.gl
def test_item_under_the_pointer_is_grabbed_or_the_reason_reported() -> None:
    with (
        Mirror(load_scene("impedance_push", by_hand=True)) as mirror,
        HeadlessRenderer(mirror.world, 320, 240) as renderer,
    ):
        clock, toggles = Clock(mirror), renderer.toggles
        pulling = Pulling(Shown(mirror, toggles=toggles, clock=clock, decor=renderer.decor))
        mirror.advance(0.0)
        renderer.render(mirror.data)
        decor = renderer.decor
        assert pulling.grab((3.0, 3.0)) is None  # the floor
        elbow = mirror.data.site_xpos[mirror.world.joints.centre_site[3]]
        at = tuple(decor.view.project(elbow)[0])
        text, is_bad = pulling.grab(at)  # type: ignore[misc]
        assert (text, is_bad) == ("pulls lwr/link4 with 500 N/m, at most 150 N", False)
        pulling.move((at[0] + 30, at[1]))
        pulling.drag()
        mirror.advance(0.2)
        clock.seek(0.2)
        hand = mirror.sources["simulation"].drag_force  # type: ignore[attr-defined]
        assert np.linalg.norm(hand.force) > 20
        assert abs(hand.force @ decor.view.forward) < 0.3 * np.linalg.norm(hand.force)
        card = mirror.world.arrows.names.index("by_hand")
        assert toggles.cards[card]
        assert pulling.wheel(1.0) == "pulls with 625 N/m, at most 150 N"
        clock.seek(0.1)
        pulling.drag()  # back in the past
        assert not (pulling.is_on or toggles.cards[card])
        text, is_bad = pulling.grab(at)  # type: ignore[misc]
        assert is_bad
        assert text == "the past cannot be changed. Return to the current time, 0.20 s"


@pytest.mark.gl
@pytest.mark.parametrize(
    ("name", "why"),
    [("lwr", "lwr is not simulated"), ("lwr_udp", "lwr is mirrored from packets")],
)
def test_robots_that_are_not_simulated_cannot_be_pushed(name: str, why: str) -> None:
    scene = load_scene(name, {"sources.udp.port": 0} if name == "lwr_udp" else {})
    with Mirror(scene) as mirror, HeadlessRenderer(mirror.world, 320, 240) as renderer:
        pulling = Pulling(Shown(mirror, decor=renderer.decor))
        renderer.render(mirror.data)
        elbow = mirror.data.site_xpos[mirror.world.joints.centre_site[3]]
        at = tuple(renderer.decor.view.project(elbow)[0])
        text, is_bad = pulling.grab(at)  # type: ignore[misc]
        assert (text, is_bad) == (f"{why}; only simulated robots can be pulled", True)
        assert not pulling.is_on


@pytest.fixture(scope="module")
def display() -> Iterator[str]:
    with screen() as name:
        yield name


@pytest.mark.thorough
@pytest.mark.gl
@pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")
def test_drag_with_control_pulls_in_a_window(display: str, tmp_path: Path) -> None:
    settings = ("run.duration=30",)
    with Driven(display, tmp_path, "impedance_push", settings=settings) as window:
        joint = "w.data.site_xpos[w.world.joints.centre_site][3]"
        x, y = window.ask(f"w.decor.view.project({joint})[0].tolist()")
        y = window.ask("w.gl.size[1] - w.decor.rect.bottom") - y
        camera = "[w.navigator.camera.azimuth, *w.navigator.camera.lookat.tolist()]"
        seen = window.ask(camera)
        shown = "bool(w.toggles.vectors[w.world.arrows.names.index('by_hand')])"
        assert not window.ask(shown)  # nor in the legend, before anything is pulled
        window.tool("mousemove", round(x), round(y))
        window.tool("keydown", "ctrl", "mousedown", 1)
        window.tool("mousemove", round(x) - 40, round(y) - 30)
        window.until("w.tools['pulling'].is_on")
        assert window.ask(shown)
        window.until("__import__('numpy').linalg.norm(w.tools['pulling']._force.force) > 20")
        assert window.ask("w.notice.text").startswith("pulls lwr/link4 with 500 N/m")
        window.tool("click", 4)
        window.until("w.tools['pulling']._force.stiffness > 600")
        window.tool("mouseup", 1, "keyup", "ctrl")
        window.until("not w.tools['pulling'].is_on")
        assert window.ask(camera) == seen  # neither rotated nor moved nor zoomed
        window.key("k")
        # Its page may be reported by then.
        window.until("'impedance_push_pushed.' in w.notice.text")
    found = read_run(tmp_path / "impedance_push_pushed.mcap").signals["by_hand_force"]
    assert np.linalg.norm(found, axis=1).max() > 20
    assert read_scenario(tmp_path / "impedance_push_pushed.toml").disturbances["push1"].at == (  # type: ignore[attr-defined]
        "lwr/link4"
    )
