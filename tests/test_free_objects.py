"""Objects with a mass: they fall, slide, are logged, shown and judged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import raises_with

from sero_mj import DeclarationError, Mirror, Plant, Scene, SerialRobot, World
from sero_mj.base.frames import frame, rotation_from_rpy
from sero_mj.robots.declared.surroundings import Object
from sero_mj.simulate.log_output import RunRecorder
from sero_mj.simulate.runs.run_recording import read_run
from sero_mj.simulate.scenario import Scenario
from sero_mj.simulate.simulated_scene import simulated_scene
from sero_mj.simulate.simulation import Simulation

G = 9.81
CAN = {"name": "can", "shape": "cylinder", "size": [0.03, 0.12], "mass": 0.2}
TURNED = frame(rotation_from_rpy(np.array([0.4, 0.2, -0.3])), np.array([0.6, 0.1, 1.0]))


def scene(*objects: dict[str, object], **more: object) -> Scene:
    """Returns objects beside a robot that hardly moves."""
    robot = SerialRobot(name="arm", dh_convention="craig", dh_params=[[0, 0, 0, 0.2]])
    return Scene(robots=[robot], objects=[Object(**each) for each in objects], **more)


def run_of(*objects: dict[str, object], duration: float = 0.4, **more: object) -> Simulation:
    simulation = Simulation(Scenario(scene(*objects), duration=duration, **more))
    simulation.advance(simulation.steps)
    return simulation


def test_object_falls_freely_until_it_rests_on_the_floor() -> None:
    log = run_of({**CAN, "frame": TURNED}, duration=1.5).log
    found, times = log.signals["can_frame"], log.times
    free = times < 0.4
    np.testing.assert_allclose(
        found[free, :3, 3], TURNED[:3, 3] - np.outer(0.5 * G * times[free] ** 2, [0, 0, 1]),
        atol=3e-3,
    )  # fmt: skip
    np.testing.assert_allclose(found[free, :3, :3], TURNED[None, :3, :3] + 0 * found[free, :3, :3])
    assert 0.02 < found[-1, 2, 3] < 0.07  # lying or upright


def test_inertia_is_that_of_a_solid_body() -> None:
    world = World(scene(CAN), dynamic=True)
    body = world.model.body("moved-can")
    m, r, h = 0.2, 0.03, 0.12
    across, along = m * (3 * r**2 + h**2) / 12, m * r**2 / 2
    assert body.mass[0] == pytest.approx(m)
    np.testing.assert_allclose(sorted(body.inertia), sorted([across, across, along]))


@pytest.mark.parametrize("friction", [0.1, 0.3, None, 0.6])
def test_object_slides_down_a_slope_by_its_friction(friction: float | None) -> None:
    slope = 0.45  # rad
    R = rotation_from_rpy(np.array([0.0, slope, 0.0]))
    plate = {"name": "plate", "shape": "box", "size": [2.0, 0.4, 0.02],
             "frame": frame(R, np.array([2.0, 0.0, 1.0]))}  # fmt: skip
    at = np.array([2.0, 0.0, 1.0]) + R @ [-0.6, 0.0, 0.01 + 0.02 - 0.002]
    block = {"name": "block", "shape": "box", "size": [0.1, 0.1, 0.04], "mass": 0.5,
             "frame": frame(R, at), "friction": friction}  # fmt: skip
    log = run_of(plate, block, duration=0.6).log
    way = (log.signals["block_frame"][:, :3, 3] - at) @ R[:, 0]
    mu = 0.3 if friction is None else friction
    expected = max(G * (np.sin(slope) - mu * np.cos(slope)), 0.0)
    # From 0.2 s on, after the initial contact: constant acceleration.
    a, b, c = (way[np.searchsorted(log.times, t)] for t in (0.2, 0.4, 0.6))
    assert (c - 2 * b + a) / 0.04 == pytest.approx(expected, abs=0.06)


def test_collisions_conserve_momentum() -> None:
    balls = [
        {"name": name, "shape": "sphere", "size": [0.05], "mass": mass, "friction": 0.0,
         "frame": frame(position=np.array([x, 0.0, 2.0]))}
        for name, mass, x in (("light", 0.2, 0.5), ("heavy", 0.6, 0.7))
    ]  # fmt: skip
    plant = Plant(World(scene(*balls), dynamic=True))
    at = {name: plant.world.free_objects[name] for name in ("light", "heavy")}
    speed = {name: slice(plant.model.body(f"moved-{name}").dofadr[0], None) for name in at}

    def along() -> np.ndarray:
        return np.array([plant.data.qvel[speed[name]][0] for name in at])

    plant.data.qvel[speed["light"]][0] = 2.0
    plant.refresh()
    for _ in range(300):
        plant.step(np.zeros(1))
    after = along()
    assert after @ [0.2, 0.6] == pytest.approx(0.2 * 2.0, rel=1e-6)
    assert 0.3 < after[1] < 1.0 and after[0] < after[1]  # 0.5 if they stick, 1.0 if they bounce


def test_recordings_and_views_contain_the_object_pose(tmp_path: Path) -> None:
    simulation = Simulation(Scenario(scene({**CAN, "frame": TURNED}), duration=0.2))
    path = tmp_path / "run.mcap"
    with RunRecorder(simulation, path) as recorder:
        for first, stop in simulation.run():
            recorder.write(first, stop)
    logged = simulation.log.signals["can_frame"]
    found = read_run(path, scene=simulation.scenario.scene)
    np.testing.assert_allclose(found.signals["can_frame"], logged)
    with Mirror(simulated_scene(simulation)) as mirror:
        mirror.advance(float(simulation.log.times[150]))
        geom = mirror.world.model.geom("can").id
        np.testing.assert_allclose(mirror.data.geom_xpos[geom], logged[150, :3, 3], atol=1e-3)


def test_restarted_run_begins_at_the_declared_object_pose() -> None:
    simulation = run_of(CAN)
    first = simulation.rows.copy()
    simulation.restart(np.zeros(1), 0)
    simulation.advance(simulation.steps)
    np.testing.assert_array_equal(simulation.rows, first)


def test_measures_report_the_object_motion() -> None:
    bounds = {"below": 100.0, "of": "final", "object": "can"}
    expect = {m: {"measure": m, **bounds} for m in ("height", "displacement", "tilt")}
    simulation = run_of({**CAN, "frame": TURNED}, duration=1.0, expect=expect)
    first, last = simulation.log.signals["can_frame"][[0, -1]]
    values = [outcome.value for outcome in simulation.outcomes()]
    turn = np.arccos(first[:3, 2] @ last[:3, 2])
    np.testing.assert_allclose(
        values, [last[2, 3], np.linalg.norm(last[:3, 3] - first[:3, 3]), turn]
    )
    assert "at can, expected below 100" in simulation.outcomes()[0].text


def test_only_solid_objects_can_have_a_mass() -> None:
    for fields, reason in (
        ({"shape": "axes", "mass": 1.0},
         "mass: found 1 for axes; expected a solid shape or a mesh"),
        ({"mjcf": "<mujoco/>", "friction": 0.5},
         "friction: found 0.5 for an MJCF object; expected the friction in the geoms of the MJCF"),
    ):  # fmt: skip
        with pytest.raises(DeclarationError) as caught:
            Object(name="x", **fields)
        assert str(caught.value) == reason
    with raises_with(key="mass", found=0):
        Object(name="x", shape="sphere", size=[1.0], mass=0)


@pytest.mark.parametrize(
    ("expect", "reason"),
    [
        ({"measure": "height", "above": 1}, "expect.e.measure: 'height' requires "),
        ({"measure": "velocity", "object": "can", "below": 1}, "expect.e: `object` requires "),
        ({"measure": "tilt", "object": "cam", "below": 1},
         "expect.e.object: no object 'cam'; did you mean 'can'?"),
        ({"measure": "tilt", "object": "table", "below": 1},
         "expect.e.object: 'table' is fixed; expected an object with a mass"),
        ({"measure": "tilt", "robot": "arm", "below": 1},
         "expect.e.robot: the base of 'arm' is fixed; expected free_base = true"),
    ],
)  # fmt: skip
def test_invalid_object_expectations_are_rejected(expect: dict[str, object], reason: str) -> None:
    table = {"name": "table", "shape": "box", "size": [1.0, 1.0, 0.1]}
    with pytest.raises(DeclarationError) as caught:
        Scenario(scene(CAN, table), expect={"e": expect})
    assert str(caught.value).startswith(reason)
