"""`overlay`: what is drawn on a third-party model, compared with a second computation."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from conftest import raises_with
from decor_tools import belonging, labels, look, width_of
from foreign_models import arm, compiled, jaco

import sero_mj
from sero_mj.base.errors import UnknownName, UsageError
from sero_mj.robots.assemble.world import World
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import GeomBuffer, Kind
from sero_mj.viewer.decor.image_view import ImageView
from sero_mj.viewer.decor.round_arrows import FULL_WIDTH
from sero_mj.viewer.decor.toggles import Toggles

EVERYWHERE = look((2.0, -2.0, 1.5), (0.0, 0.0, 0.4))


def drawn(overlay: Any, view: ImageView = EVERYWHERE) -> GeomBuffer:
    """Returns the geoms that decor draws for an overlay."""
    return Decor(overlay.world).draw(overlay.data, overlay.toggles, view)


def everything_of(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[bytes, bytes]:
    """Returns all bytes of a model and of a state with its derived quantities."""
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    parts = [state, data.xpos, data.xmat, data.qfrc_actuator, data.qacc, data.geom_xpos]
    return buffer.tobytes(), b"".join(part.tobytes() for part in parts)


def test_arrows_are_at_the_joints_and_rotate_about_their_axes() -> None:
    model, data = arm(turn=0.4, lift=-0.7, elbow=1.1, grip=0.03)
    overlay = sero_mj.overlay(model, data)
    geoms = drawn(overlay)
    radius = overlay.world.joints.arrow_radius
    for item, name in enumerate(("turn", "lift", "elbow")):
        (arrow,) = belonging(geoms, Kind.ARROW, item)
        joint = data.joint(name)
        assert arrow["pos"] == pytest.approx(joint.xanchor, abs=1e-6)
        assert arrow["size"][:2] == pytest.approx(radius[item], rel=1e-5)
        # It rotates by the right-hand rule, or opposite to it.
        axis = np.sign(joint.qfrc_actuator) * joint.xaxis
        assert arrow["mat"][:, 2] == pytest.approx(axis, abs=1e-6)


def test_widths_and_colors_follow_the_actuator_torques() -> None:
    model, data = arm()
    overlay = sero_mj.overlay(model, data)
    torque = np.array([data.joint(name).qfrc_actuator[0] for name in overlay.robots["arm"]])
    # ctrl -1.5, gear 10; 9 at gear 2; 0.05 at gear 100; no gear
    assert torque == pytest.approx([-15.0, 18.0, 5.0, 0.4])
    radius, geoms = overlay.world.joints.arrow_radius, drawn(overlay)
    for item, limit in enumerate((20.0, 60.0, 15.0)):
        arrow = belonging(geoms, Kind.ARROW, item)[0]
        expected = FULL_WIDTH * radius[item] * np.sqrt(abs(torque[item]) / limit)
        assert width_of(arrow) == pytest.approx(expected, rel=1e-5)
        assert (arrow["rgba"][0] > arrow["rgba"][2]) == (torque[item] > 0)  # orange, or blue


def test_full_width_without_a_limit_is_the_gravity_load() -> None:
    model, data = arm()
    overlay = sero_mj.overlay(model, data)
    overlay.set("arm.torques", [0, 0, 0, 0.1 * 9.81])  # the weight of the sliding part
    shaft, _ = belonging(drawn(overlay), Kind.ARROW, 3)
    radius = overlay.world.joints.arrow_radius[3]
    assert shaft["size"][0] == pytest.approx(FULL_WIDTH * radius, rel=1e-5)


def test_arrow_of_a_prismatic_joint_moves_with_its_link() -> None:
    at = []
    for grip in (0.0, 0.05):
        model, data = arm(grip=grip)
        overlay = sero_mj.overlay(model, data)
        at.append(belonging(drawn(overlay), Kind.ARROW, 3)["pos"][0].astype(float))
        axis = data.joint("grip").xaxis.copy()
    assert at[1] - at[0] == pytest.approx(0.05 * axis, abs=1e-6)


def test_arrow_rotates_at_constant_speed_regardless_of_its_joint() -> None:
    """Measured from the parent body, the tail is where time alone has brought it."""
    tails = []
    for elbow in (0.0, 0.5, 2.0):
        model, data = arm(lift=0.3, elbow=elbow)
        geoms = drawn(sero_mj.overlay(model, data))
        tail = belonging(geoms, Kind.ARROW, 2)["mat"][0][:, 0].astype(float)
        tails.append(tail @ data.body("upper").xmat.reshape(3, 3))
    assert tails[1] == pytest.approx(tails[0], abs=1e-6)
    assert tails[2] == pytest.approx(tails[0], abs=1e-6)


@pytest.mark.parametrize("quantity", ["torques", "torque_error", "joint_accelerations"])
def test_overlay_on_our_own_model_draws_the_same_as_its_scene(quantity: str) -> None:
    """The LWR, compiled from its DH table, against the same arrows found in the compiled model."""
    torques = np.array([30.0, -80.0, 12.0, 250.0, -3.0, 9.0, -6.0])
    robot = sero_mj.SerialRobot.from_model(
        "lwr", show_arrows=True, arrow_quantity=quantity, acceleration_limits=[9.0] * 7
    )
    world = World(sero_mj.Scene(robots=[robot]))
    data = world.make_data()
    data.qpos[:] = (0.3, 0.5, -0.7, -1.1, 0.4, 0.9, -0.2)
    data.time = 1.7
    mujoco.mj_forward(world.model, data)
    overlay = sero_mj.overlay(
        world.model,
        data,
        robots={
            "lwr": {
                "arrow_radius": robot.arrow_radius,
                "offsets_to_center_of_joints": robot.offsets,
                "torque_limits": robot.torque_limits,
                "acceleration_limits": robot.acceleration_limits,
                "arrow_quantity": quantity,
            }
        },
    )
    for name, value in (("torques", torques), ("commanded_torques", torques[::-1] * 0.7)):
        world.set_input(data, f"lwr.{name}", value)
        overlay.set(f"lwr.{name}", value)
    world.set_input(data, "lwr.joint_accelerations", torques / 10)
    overlay.set("lwr.joint_accelerations", torques / 10)
    theirs = Decor(world).draw(data, Toggles(world), EVERYWHERE)
    ours = drawn(overlay)
    assert ours.dropped == theirs.dropped == 0
    for item in range(7):
        mine, scene = (belonging(geoms, Kind.ARROW, item) for geoms in (ours, theirs))
        assert len(mine) == len(scene) > 0
        for field in ("type", "pos", "mat", "size", "rgba"):
            assert mine[field] == pytest.approx(scene[field], abs=1e-5), (item, field)


def test_overlay_does_not_change_the_user_model_and_data() -> None:
    model, data = jaco()
    before = everything_of(model, data)
    overlay = sero_mj.overlay(
        model,
        data,
        doubles=[sero_mj.Double(name="goal", of="jaco")],
        frames=["jaco/jaco_hand/hand"],
    )
    overlay.set("goal.joint_angles", data.qpos + 0.3)
    overlay.set("jaco.torques", np.arange(9.0))
    overlay.toggles.billboards[:] = overlay.toggles.axes[:] = True
    drawn(overlay)
    assert everything_of(model, data) == before


def test_every_robot_of_a_model_has_its_own_joints() -> None:
    model, data = jaco(2)
    overlay = sero_mj.overlay(model, data)
    assert list(overlay.robots) == ["jaco0", "jaco1"]
    overlay.set("jaco1.torques", {"joint_2": 20.0})
    geoms = drawn(overlay)
    assert set(geoms.items[: geoms.count][geoms.kinds[: geoms.count] == Kind.ARROW]) == {9 + 1}
    (arrow,) = belonging(geoms, Kind.ARROW, 10)
    assert arrow["pos"] == pytest.approx(data.joint("jaco1/joint_2").xanchor, abs=1e-6)
    assert arrow["size"][0] == pytest.approx(overlay.world.joints.arrow_radius[10], rel=1e-5)


def test_values_that_are_set_are_shown_until_cleared() -> None:
    model, data = arm()
    overlay = sero_mj.overlay(model, data)
    overlay.set("arm.torques", {"lift": -20.0})
    items = lambda geoms: set(geoms.items[: geoms.count][geoms.kinds[: geoms.count] == Kind.ARROW])  # noqa: E731
    assert items(drawn(overlay)) == {1}
    overlay.clear("arm.torques")
    assert items(drawn(overlay)) == {0, 1, 2, 3}
    overlay.toggles.arrow_quantity[:] = 1  # torque error: nothing was commanded
    assert items(drawn(overlay)) == set()
    overlay.set("arm.commanded_torques", [0.0, 0.0, 0.0, 0.0])
    assert items(drawn(overlay)) == {0, 1, 2, 3}


def test_vector_of_the_whole_model_is_split_among_its_robots() -> None:
    model, data = compiled("""<mujoco><worldbody>
      <body name="cube"><freejoint/><geom size=".1"/></body>
      <body name="a" pos="1 0 0"><joint/><geom size=".1"/></body>
      <body name="b" pos="2 0 0"><joint/><geom size=".1"/>
        <body pos="0 0 .3"><joint/><geom size=".1"/></body></body>
      </worldbody></mujoco>""")
    overlay = sero_mj.overlay(model, data, doubles=[sero_mj.Double(name="goal", of="b")])
    whole = np.arange(9.0)
    for name, expected in (("a", [6]), ("b", [7, 8]), ("goal", [7, 8])):
        overlay.set(f"{name}.commanded_torques", whole)
        overlay.robot(name).torques = -whole
        assert overlay.robot(name).commanded_torques == pytest.approx(expected)
        assert overlay.robot(name).torques == pytest.approx(-np.array(expected))
    with raises_with(
        key="b.torques",
        reason="found shape",
        found=(3,),
        expected="2, one per joint: shape (2,), "
        "or one per degree of freedom of the model: shape (9,)",
    ):
        overlay.set("b.torques", np.zeros(3))
    with raises_with(
        key="goal.joint_angles",
        reason="found shape",
        found=(9,),
        expected="2, one per joint: shape (2,)",
    ):  # joint angles are not degrees of freedom
        overlay.set("goal.joint_angles", whole)


def test_values_that_are_not_finite_are_counted_and_not_shown(caplog: Any) -> None:
    model, data = arm()
    double = sero_mj.Double(name="goal", of="arm", joint_angles=np.array([0.5, 0, 0, 0]))
    overlay = sero_mj.overlay(model, data, doubles=[double])
    overlay.set("arm.torques", [np.nan, 18.0, np.inf, 0.3])
    geoms = drawn(overlay)
    assert set(geoms.items[: geoms.count][geoms.kinds[: geoms.count] == Kind.ARROW]) == {1, 3}
    assert overlay.not_finite == 2
    assert "arm.torques: NaN" in caplog.text
    kept = overlay.frame("goal/fore")
    overlay.set("goal.joint_angles", [0.1, np.nan, 0, 0])
    assert overlay.frame("goal/fore") == pytest.approx(kept)  # its last valid pose
    assert overlay.not_finite == 3
    overlay.set("goal.joint_angles", [0.1, 1e308, 0, 0])
    assert overlay.frame("goal/fore") == pytest.approx(kept)
    overlay.set("arm.torques", [1e300, 18.0, 1.0, 0.3])
    assert overlay.not_finite == 5
    data.xpos[:], data.xmat[:], data.xanchor[:], data.xaxis[:] = [np.nan] * 4
    geoms = drawn(overlay)
    assert np.isfinite(geoms.rows["pos"][: geoms.count]).all()


def test_axes_are_drawn_at_bodies_and_requested_sites() -> None:
    model, data = arm(turn=0.4, elbow=1.1)
    overlay = sero_mj.overlay(model, data, frames=["tip", "cube"])
    assert overlay.world.frames.names == [
        "arm/base", "arm/upper", "arm/fore", "arm/gripper", "tip", "cube",
    ]  # fmt: skip
    overlay.set("arm.show_axes", 1)
    geoms = drawn(overlay)
    expected = [(data.body(name).xpos, data.body(name).xmat) for name in ("arm", "upper", "fore")]
    expected += [(data.body("gripper").xpos, data.body("gripper").xmat)]
    expected += [(data.site("tip").xpos, data.site("tip").xmat)]
    expected += [(data.body("cube").xpos, data.body("cube").xmat)]
    for item, (position, rotation) in enumerate(expected):
        bars = belonging(geoms, Kind.AXES, item)
        assert len(bars) == 3
        for axis, bar in enumerate(bars):
            direction = rotation.reshape(3, 3)[:, axis]
            assert bar["mat"][:, 2] == pytest.approx(direction, abs=1e-6)
            assert bar["pos"] == pytest.approx(position, abs=1e-6)
        assert overlay.frame(overlay.world.frames.names[item])[:3, 3] == pytest.approx(position)


def test_smart_arrows_are_drawn_at_frames_and_points() -> None:
    model, data = arm(turn=0.4)
    arrows = [
        sero_mj.SmartArrow(name="push", at="arm/fore", expressed_in="world", vector=[0, 0, 30.0]),
        sero_mj.SmartArrow(name="there", at=[0.5, 0.1, 0.9], vector=[20.0, 0, 0]),
    ]
    geoms = drawn(sero_mj.overlay(model, data, arrows=arrows))
    assert belonging(geoms, Kind.VECTOR, 0)["pos"][0] == pytest.approx(data.body("fore").xpos)
    assert belonging(geoms, Kind.VECTOR, 0)["mat"][0][:, 2] == pytest.approx([0, 0, 1], abs=1e-6)
    assert belonging(geoms, Kind.VECTOR, 1)["pos"][0] == pytest.approx([0.5, 0.1, 0.9])


def test_singularity_is_shown_for_the_serial_part() -> None:
    """Three joints in a row, stretched out: the elbow's arrow leads there from either side."""
    model, data = compiled("""<mujoco><worldbody><body name="a">
      <joint axis="0 1 0"/><geom size=".05"/>
      <body pos="0 0 1"><joint name="e" axis="0 1 0"/><geom size=".05"/>
      <body pos="0 0 1"><geom size=".05"/></body></body></body></worldbody></mujoco>""")
    overlay = sero_mj.overlay(model, data, robots={"a": {"arrow_quantity": "singularity"}})
    for elbow, blue in ((0.1, True), (-0.1, False)):
        data.joint("e").qpos = elbow
        mujoco.mj_forward(model, data)
        box = belonging(drawn(overlay), Kind.ARROW, 1)[0]
        assert (box["rgba"][2] > box["rgba"][0]) == blue


def test_joint_without_torque_limit_has_the_same_singularity_arrow_width() -> None:
    model, data = arm()
    overlay = sero_mj.overlay(model, data, robots={"arm": {"torque_limits": None}})
    overlay.toggles.arrow_quantity[:] = 2
    joints = overlay.world.joints
    assert np.isinf(joints.torque_limit).all() and np.isfinite(joints.acceleration_limit).all()
    overlay.set("arm.joint_accelerations", joints.acceleration_limit / 4)
    geoms = drawn(overlay)
    for item in range(3):  # half the full width at a quarter of the limit
        width = width_of(belonging(geoms, Kind.ARROW, item)[0])
        assert width == pytest.approx(FULL_WIDTH * joints.arrow_radius[item] / 2, rel=1e-5)


def chain_overlay(count: int) -> tuple[sero_mj.Overlay, Any]:
    """Returns a chain of many joints with all billboards on, and a function for its panels."""
    body = '<body pos="0 0 .1"><joint name="{0}_joint"/><geom size=".03"/>{1}</body>'
    xml = ""
    for k in reversed(range(count)):
        xml = body.format(f"vertebra_of_the_spine_{k}", xml)
    overlay = sero_mj.overlay(*compiled(f"<mujoco><worldbody>{xml}</worldbody></mujoco>"))
    overlay.toggles.billboards[:] = True
    scene = mujoco.MjvScene(overlay.model, maxgeom=5000)

    def panels(width: int = 640, height: int = 480) -> Any:
        scene.ngeom = 0
        overlay.draw(scene, f"90,-10,{0.25 * count}", (width, height))
        return overlay._drawn.panels

    return overlay, panels


@pytest.mark.parametrize("size", [(640, 480), (1280, 800)])
@pytest.mark.parametrize("count", [6, 60])
def test_billboards_of_a_chain_do_not_overlap(size: tuple[int, int], count: int) -> None:
    _, panels = chain_overlay(count)
    found = panels(*size)
    low = np.concatenate([p.centres - p.sizes / 2 for p in found])
    high = np.concatenate([p.centres + p.sizes / 2 for p in found])
    apart = ((high[:, None] <= low + 1e-6) | (low[:, None] >= high - 1e-6)).any(axis=2)
    assert (apart | np.eye(len(low), dtype=bool)).all()
    cards = sum(len(p.texts) for p in found if p.has_values)
    notes = [line for p in found for lines in p.texts for line in lines if b" of 60 " in line]
    assert cards == 6 if count == 6 else 4 < cards < 48
    expected = [b"%d of 60 joints shown: highest loads" % cards]
    assert notes == ([] if count == 6 else expected)


def test_billboards_of_the_most_loaded_joints_are_shown_and_stay() -> None:
    overlay, panels = chain_overlay(60)
    robot = overlay.robot(next(iter(overlay.robots)))
    load = overlay.world.joints.arrow_load

    def items() -> set[int]:
        (cards,) = [p for p in panels(1280, 800) if p.has_values]
        return set(cards.items.tolist())

    share = np.full(60, 0.1)
    share[20:30] = 0.5
    robot.torques = share * load
    first = items()
    assert first >= set(range(20, 30))
    others = sorted(set(range(60)) - first)
    share[others] = 0.11  # slightly more than those that have a billboard
    robot.torques = share * load
    assert items() == first
    share[others[:2]] = 0.4
    robot.torques = share * load
    assert items() >= {*others[:2], *range(20, 30)}
    hidden = next(iter(set(range(60)) - items()))
    overlay.toggles.details[hidden] = True  # clicked on
    assert hidden in items()
    robot.torques = np.full(60, np.nan)
    assert hidden in items()


def test_drawing_a_frame_is_fast() -> None:
    import time

    model, data = jaco(2)
    overlay = sero_mj.overlay(model, data)
    overlay.set("jaco0.torques", np.ones(9))
    decor = Decor(overlay.world)
    best = np.inf
    for _ in range(50):
        begin = time.perf_counter()
        decor.draw(data, overlay.toggles, EVERYWHERE)
        best = min(best, time.perf_counter() - begin)
    assert best < 4e-3  # s


@pytest.mark.slow
@pytest.mark.parametrize("name", ["acrobot", "cheetah", "hopper", "humanoid", "humanoid_CMU"])
def test_third_party_models_have_moving_arrows(name: str) -> None:
    suite = pytest.importorskip(f"dm_control.suite.{name}", reason="dm-control is not installed")
    xml, assets = suite.get_model_and_assets()
    model = mujoco.MjModel.from_xml_string(xml, assets)
    data = mujoco.MjData(model)
    overlay = sero_mj.overlay(model, data)
    single = np.isin(model.jnt_type, (2, 3))
    assert sum(len(joints) for joints in overlay.robots.values()) == single.sum()
    data.ctrl[:] = 0.7
    for _ in range(3):
        mujoco.mj_step(model, data)
    geoms = drawn(overlay)
    driven = np.abs(data.qfrc_actuator[overlay.world.robots[next(iter(overlay.robots))].dofs]) > 0
    arrows = np.unique(geoms.items[: geoms.count][geoms.kinds[: geoms.count] == Kind.ARROW])
    assert len(arrows) and driven[arrows].all()


def test_data_without_computed_frames_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    model, _ = arm()
    data, canvas = mujoco.MjData(model), mujoco.MjvScene(model, 2000)
    early = sero_mj.overlay(model, data, name="early")
    mujoco.mj_forward(model, data)
    early.draw(canvas, "150,-20,2.5")
    assert not caplog.records  # it has frames when it is drawn
    bare = sero_mj.overlay(model, mujoco.MjData(model), name="bare")
    for _ in range(2):
        bare.draw(canvas, "150,-20,2.5")
    (record,) = caplog.records
    assert record.getMessage().startswith("the data of bare has no frames yet")
    assert "call mujoco.mj_forward(model, data)" in record.getMessage()
    caplog.clear()
    sero_mj.overlay(model).draw(canvas, "150,-20,2.5")  # the overlay makes its own data
    assert not caplog.records


def test_arguments_of_another_type_are_rejected() -> None:
    model, data = arm()
    with raises_with(
        UsageError,
        key="robots",
        found=["arm"],
        expected="a mapping from robots to fields, such as {'arm': {'arrow_radius': 0.06}}",
    ):
        sero_mj.overlay(model, data, robots=["arm"])  # type: ignore[arg-type]
    with raises_with(UsageError, key="width", found="640", expected="a number of pixels"):
        sero_mj.overlay(model, data).image("640", 480)  # type: ignore[arg-type]
    with raises_with(UnknownName, kind="body or site", name="tp", near="tip"):
        sero_mj.overlay(model, data, frames="tp")


def test_legend_states_the_full_width_of_arrows_without_limit() -> None:
    overlay = sero_mj.overlay(*arm())
    joints = overlay.world.joints
    joints.torque_limit[:] = np.inf
    assert np.isfinite(joints.arrow_load).any()
    geoms = drawn(overlay)
    assert "width grows up to 1.5 times gravity's load" in labels(geoms.rows[: geoms.count])
