"""Arrays shared by a viewer and its process, tested without a process: both ends are here."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from conftest import raises_with
from foreign_models import arm

import sero_mj
from sero_mj import Double, Object, Scene, SerialRobot, SmartArrow, UdpReceiver, World
from sero_mj.base import errors
from sero_mj.base.errors import SeroError, UnknownName
from sero_mj.data.drive.mirror import Mirror
from sero_mj.load import load_scene
from sero_mj.robots.external.model_world import ModelWorld
from sero_mj.viewer.decor.quantities import joint_values
from sero_mj.viewer.program.memory import OverlayMemory, SceneMemory, SharedArrays
from sero_mj.viewer.program.process import _pickled


def test_array_is_read_once_and_whole_or_not_at_all() -> None:
    ours = SharedArrays([3, 0, 2])
    theirs = SharedArrays([3, 0, 2], ours.path)
    assert not ours.path.exists()  # no file remains, whichever end closes first
    assert theirs.changed() == [] and theirs.read(0) is None
    ours.write(0, np.array([1.0, np.nan, -np.inf]))
    ours.write(1, np.empty(0))
    assert theirs.changed() == [0, 1]
    assert str(theirs.read(0)) == "[  1.  nan -inf]" and theirs.read(0) is None
    found = theirs.read(1)
    assert found is not None and found.size == 0
    # As if the writer stopped in the middle of a write.
    ours.write(2, np.array([5.0, 6.0]))
    ours._cells[-1] = 7.0
    assert theirs.changed() == [2] and theirs.read(2) is None
    ours.write(2, np.array([8.0, 9.0]))
    assert str(theirs.read(2)) == "[8. 9.]" and theirs.number(2) == 2


@pytest.fixture
def ends() -> tuple[SceneMemory, SceneMemory]:
    """Returns the memory of a scene at its user and at the process that shows it."""

    def world() -> World:
        return World(
            Scene(
                robots=[SerialRobot.from_model("lwr"), SerialRobot.from_model("lwr", name="two")],
                doubles=[Double(name="goal", of="lwr")],
                arrows=[SmartArrow(name="push", at="lwr/flange")],
            )
        )

    ours, theirs = world(), world()
    memory = SceneMemory(ours, ours.make_data())
    return memory, SceneMemory(theirs, theirs.make_data(), memory.arrays.path)


def test_values_that_are_set_arrive_and_nothing_else(ends: tuple[SceneMemory, SceneMemory]) -> None:
    ours, theirs = ends
    world, data = theirs._world, theirs.data
    world.set_input(data, "lwr.torques", np.full(7, 3.0))  # from a source, for example
    moved = np.eye(4)
    moved[:3, 3] = 1.0, 2.0, 3.0
    ours.set("lwr.joint_angles", [0.1] * 7)
    ours.set("goal.joint_angles", np.arange(7))
    ours.set("two.torques", [1, np.nan, 3, 4, 5, 6, np.inf])
    ours.set("two.base_frame", moved)
    ours.set("push.vector", (1.0, 2.0, 3.0))
    ours.set("toggles.legend", False)
    theirs.apply()
    expected = world.make_data()
    world.set_input(expected, "lwr.torques", np.full(7, 3.0))
    for target, values in (
        ("lwr.joint_angles", [0.1] * 7),
        ("goal.joint_angles", np.arange(7)),
        ("two.torques", [1, np.nan, 3, 4, 5, 6, np.inf]),
        ("two.base_frame", moved),
        ("push.vector", (1.0, 2.0, 3.0)),
        ("toggles.legend", False),
    ):
        world.set_input(expected, target, values)
    for field in ("qpos", "userdata", "mocap_pos", "mocap_quat"):
        assert np.array_equal(getattr(data, field), getattr(expected, field), equal_nan=True), field
    # Applied values are not applied again over newer values of a source.
    world.set_input(data, "lwr.joint_angles", [0.7] * 7)
    theirs.apply()
    assert data.qpos[world.robots["lwr"].qpos].tolist() == [0.7] * 7


def test_invalid_values_are_rejected_where_they_are_set(
    ends: tuple[SceneMemory, SceneMemory],
) -> None:
    ours, theirs = ends
    with raises_with(
        key="lwr.joint_angles",
        reason="found [nan, nan, nan, nan, nan, nan, nan]",
        expected="7 finite numbers",
    ):
        ours.set("lwr.joint_angles", [np.nan] * 7)
    with raises_with(UnknownName, kind="input of lwr", name="torqes", near="torques"):
        ours.set("lwr.torqes", [0.0] * 7)
    assert theirs.arrays.changed() == []


def test_displayed_values_come_back_except_over_newer_inputs(
    ends: tuple[SceneMemory, SceneMemory],
) -> None:
    ours, theirs = ends
    world, data = theirs._world, theirs.data
    ours.is_read = True
    ours.set("lwr.torques", np.full(7, 1.0))
    theirs.apply()
    data.time = 4.5
    moved = np.eye(4)
    moved[:3, 3] = 1.0, 2.0, 3.0
    world.set_input(data, "lwr.joint_angles", [0.2] * 7)
    world.set_input(data, "two.base_frame", moved)
    theirs.show()
    ours.set("lwr.torques", np.full(7, 2.0))
    ours.sync()
    mine = ours.data
    torques = joint_values(ours._world, mine)["torques"]
    assert torques[:7].tolist() == [2.0] * 7 and np.isnan(torques[7:]).all()
    assert mine.time == 4.5 and ours.frame_count == 1
    assert np.array_equal(mine.qpos, data.qpos)
    flange = ours._world.frame(mine, "two/flange")  # frames are up to date, too
    assert flange[:2, 3] == pytest.approx([1.0, 2.0], abs=0.3)
    # Once displayed, changes by the other side come back, too (for example a reset).
    theirs.apply()
    world.set_input(data, "lwr.torques", np.full(7, 9.0))
    theirs.show()
    ours.sync()
    assert joint_values(ours._world, mine)["torques"][:7].tolist() == [9.0] * 7


def overlay_ends() -> tuple[OverlayMemory, OverlayMemory]:
    model, data = arm()
    overlay = sero_mj.overlay(
        model,
        data,
        doubles=[Double(name="goal", of="arm")],
        arrows=[SmartArrow(name="push", at="arm/fore")],
    )
    theirs_model, options = pickle.loads(_pickled((model, overlay.world.options)))
    theirs = ModelWorld(theirs_model, mujoco.MjData(theirs_model), **options)
    ours = OverlayMemory(overlay.world)
    return ours, OverlayMemory(theirs, ours.arrays.path)


def test_state_of_a_user_model_arrives_with_its_decor() -> None:
    ours, theirs = overlay_ends()
    world, data = ours._world, ours.data
    data.ctrl[:] = 0.4
    for _ in range(50):
        mujoco.mj_step(world.model, data)
    mujoco.mj_forward(world.model, data)
    world.set_input(data, "goal.joint_angles", [0.1, 0.2, 0.3, 0.01])
    world.set_input(data, "push.vector", [1.0, 2.0, 3.0])
    # The model's torques, the user's, the model's again.
    for torques in (None, {"elbow": 12.0}, None):
        if torques is None:
            world.clear_input("arm.torques")
        else:
            world.set_input(data, "arm.torques", torques)
        ours.sync()
        theirs.apply()
        assert theirs.data.time == data.time > 0.09
        assert np.abs(data.qfrc_actuator).max() > 0.1
        expected, found = world.state(data), theirs._world.state(theirs.data)
        assert np.array_equal(found.userdata, expected.userdata, equal_nan=True)
        for field in ("qpos", "xpos", "xmat", "site_xpos", "site_xmat"):
            assert getattr(found, field) == pytest.approx(getattr(expected, field), abs=1e-12)
        assert found.doubles["goal"][0].xpos == pytest.approx(expected.doubles["goal"][0].xpos)
        ours_values, theirs_values = (joint_values(end._world, end.data) for end in (ours, theirs))
        for key, values in ours_values.items():
            assert np.array_equal(values, theirs_values[key], equal_nan=True), key


def test_scene_is_pickled_completely() -> None:
    here = load_scene("lwr_contact")
    there = pickle.loads(_pickled(here))
    assert there.routes == here.routes and there.sources == here.sources
    one, other = World(here), World(there)
    assert list(one.inputs) == list(other.inputs)
    assert (one.make_data().userdata == other.make_data().userdata).all()
    assert (one.model.geom_rgba == other.model.geom_rgba).all()


def test_simulation_is_repeated_to_the_same_log_unless_it_has_ended() -> None:
    scene = load_scene("drive_home")
    (source,) = scene.sources.values()
    source.run.advance(20)
    (other,) = pickle.loads(_pickled(scene)).sources.values()
    assert other.run.step == 0 and other.end == source.end
    other.run.advance(20)
    assert np.array_equal(other.run.rows, source.run.rows)
    source.run.advance(source.run.steps)
    (done,) = pickle.loads(_pickled(scene)).sources.values()
    assert np.array_equal(done.run.rows, source.run.rows)
    assert done.about == source.about and done.layout.events == source.layout.events


def test_mjcf_objects_and_opened_sources_are_pickled() -> None:
    spec = mujoco.MjSpec.from_string(
        '<mujoco><worldbody><geom type="sphere" size="0.125"/></worldbody></mujoco>'
    )
    source = UdpReceiver(structure="7F", udpport=0)
    scene = Scene(
        robots=[SerialRobot.from_model("lwr")],
        objects=[Object(name="ball", mjcf=spec)],
        sources={"udp": source},
        routes={"lwr.torques": "udp.values0"},
    )
    with Mirror(scene):
        there = pickle.loads(_pickled(scene))
    found = there.sources["udp"]
    assert type(found) is UdpReceiver and found.model_dump() == source.model_dump()
    world, other = World(scene), World(there)
    assert np.array_equal(world.model.geom_size, other.model.geom_size)


def test_unpicklable_scene_is_reported() -> None:
    scene = Scene(robots=[SerialRobot.from_model("lwr")])
    scene.sources["mine"] = lambda: None
    with pytest.raises(errors.UsageError, match="the scene cannot be sent to the viewer's process"):
        _pickled(scene)


@pytest.mark.parametrize(
    "error",
    [
        errors.DeclarationError([errors.Problem("robots.lwr", "is wrong", "a.toml", 3)]),
        errors.UnknownName("camera", "frnt", ["front"]),
        errors.StructureError("7G", 1, "expected F"),
        errors.RouteError("udp.a ** 2", 7, "expected a name", 2),
        errors.SourceError("udp", "the port is taken"),
        errors.RecordingError(Path("run.mcap"), "is damaged"),
        errors.CsvError("a.csv", "no column", line=3, column="b"),
        errors.SimulationError(1.5, "lwr/A3", "diverges"),
        errors.RenderError("no display"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_errors_are_pickled_unchanged(error: SeroError) -> None:
    found: Any = pickle.loads(pickle.dumps(error))
    assert type(found) is type(error) and str(found) == str(error)
    assert vars(found) == vars(error)
