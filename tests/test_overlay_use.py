"""`overlay` in the user's own loop: what it draws on, and what it says to wrong use."""

from __future__ import annotations

import copy
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from conftest import raises_with
from foreign_models import ARM, arm, compiled

import sero_mj
from sero_mj.base.errors import DeclarationError, SeroError, UnknownName, UsageError


@pytest.fixture
def overlay() -> Any:
    return sero_mj.overlay(*arm())


def scene_of(overlay: Any, maxgeom: int = 2000) -> mujoco.MjvScene:
    """A scene that MuJoCo has filled, as every renderer has one."""
    scene = mujoco.MjvScene(overlay.model, maxgeom=maxgeom)
    camera = mujoco.MjvCamera()
    camera.distance, camera.lookat = 2.0, (0, 0, 0.4)
    mujoco.mjv_updateScene(
        overlay.model, overlay.data, mujoco.MjvOption(), None, camera,
        mujoco.mjtCatBit.mjCAT_ALL, scene,
    )  # fmt: skip
    return scene


def test_a_scene_keeps_its_own_geoms_and_gets_more(overlay: Any) -> None:
    scene = scene_of(overlay)
    own = [(geom.objid, geom.pos.tolist()) for geom in scene.geoms[: scene.ngeom]]
    assert overlay.draw(scene, size=(800, 600)) == 0
    assert scene.ngeom > len(own) + 50
    assert [(geom.objid, geom.pos.tolist()) for geom in scene.geoms[: len(own)]] == own
    kinds = {geom.category for geom in scene.geoms[len(own) : scene.ngeom]}
    assert kinds == {int(mujoco.mjtCatBit.mjCAT_DECOR)}


@pytest.mark.parametrize("room", [0, 1, 30])
def test_what_finds_no_room_is_counted_and_said_once(overlay: Any, room: int, caplog: Any) -> None:
    needed = scene_of(overlay)
    before = needed.ngeom
    overlay.draw(needed)
    scene = scene_of(overlay, maxgeom=before + room)
    for _ in range(2):
        scene.ngeom = before
        left_out = overlay.draw(scene)
        assert left_out == overlay.dropped == needed.ngeom - before - room
        assert scene.ngeom == scene.maxgeom
    assert len(caplog.records) == 1
    assert f"{left_out} decor geoms are not shown" in caplog.text
    assert f"capacity is {scene.maxgeom}" in caplog.text


@pytest.mark.parametrize("room", [0, 2])
def test_a_double_without_room_is_counted_too(room: int) -> None:
    model, data = arm()
    double = sero_mj.Double(name="goal", of="arm", joint_angles=np.array([1.0, 0, 0, 0]))
    overlay = sero_mj.overlay(model, data, doubles=[double])
    overlay.toggles.arrows[:] = False
    scene = scene_of(overlay)
    before = scene.ngeom
    # The foot does not move, and the rest is 3 geoms.
    overlay.draw(scene)
    assert scene.ngeom - before == 3
    small = scene_of(overlay, maxgeom=before + room)
    assert overlay.draw(small) == 3 - room


def test_geoms_are_the_same_where_their_memory_is_not_as_expected(monkeypatch: Any) -> None:
    double = sero_mj.Double(name="goal", of="arm", joint_angles=np.array([1.0, 0.4, 0, 0]))
    scenes = []
    for fast in (True, False):
        if not fast:
            monkeypatch.setattr("sero_mj.viewer.decor.scene_writer.struct_view", lambda scene: None)
        overlay = sero_mj.overlay(*arm(), doubles=[double])
        scene = scene_of(overlay)
        overlay.draw(scene)
        scenes.append(
            [
                (
                    g.type,
                    g.dataid,
                    g.matid,
                    g.category,
                    g.label,
                    *g.pos,
                    *g.size,
                    *g.rgba,
                    *g.mat.flat,
                )
                for g in scene.geoms[: scene.ngeom]
            ]
        )
    assert scenes[0] == scenes[1]


def test_the_passive_viewer_is_drawn_on_from_its_own_camera(overlay: Any) -> None:
    """Its handle in 4.0: `user_scn` has no camera, `cam` is where the user looks from."""
    camera = mujoco.MjvCamera()
    camera.distance, camera.azimuth, camera.elevation = 2.0, 90.0, -20.0
    handle = SimpleNamespace(
        user_scn=mujoco.MjvScene(overlay.model, maxgeom=2000),
        cam=camera,
        viewport=mujoco.MjrRect(0, 0, 800, 500),
    )
    for _ in range(3):  # nobody else clears it
        overlay.draw(handle)
        first = handle.user_scn.ngeom
    assert first < 500
    assert (overlay.view.width, overlay.view.height) == (800, 500)
    assert overlay.view.forward == pytest.approx(
        [0, np.cos(np.deg2rad(20)), -np.sin(np.deg2rad(20))], abs=1e-6
    )


def test_a_camera_may_be_given_in_words(overlay: Any) -> None:
    scene = mujoco.MjvScene(overlay.model, maxgeom=2000)
    overlay.draw(scene, camera="90,0,3")
    assert overlay.view.forward == pytest.approx([0, 1, 0], abs=1e-6)
    with raises_with(UnknownName, kind="camera", name="side"):
        overlay.draw(scene, camera="side")


def test_other_scenes_may_be_drawn_on_in_turn(overlay: Any) -> None:
    one, other = scene_of(overlay), scene_of(overlay)
    before = one.ngeom
    overlay.draw(one)
    overlay.draw(other)
    assert one.ngeom == other.ngeom > before


@pytest.mark.parametrize(
    ("target", "message"),
    [
        (None, "found NoneType; expected a mujoco.Renderer, a viewer"),
        (SimpleNamespace(user_scn=None, cam=None), "found SimpleNamespace"),
        ("scene", "the scene has no camera yet: call update_scene before draw"),
    ],
)
def test_what_cannot_be_drawn_on_is_said(overlay: Any, target: Any, message: str) -> None:
    if target == "scene":
        target = mujoco.MjvScene(overlay.model, maxgeom=100)
    with pytest.raises(UsageError, match=message):
        overlay.draw(target)


def test_a_size_must_be_positive_and_a_click_needs_a_frame(overlay: Any) -> None:
    with pytest.raises(UsageError, match="size: found 0 x 480"):
        overlay.draw(scene_of(overlay), size=(0, 480))
    with pytest.raises(UsageError, match="nothing was drawn yet"):
        overlay.click(10, 10)


XML = '<mujoco><worldbody><body name="b">{}<geom size=".1"/></body></worldbody></mujoco>'


@pytest.mark.parametrize(
    ("inside", "message"),
    [
        ("", "model: found no joint; expected a hinge or slide joint"),
        ("<freejoint/>", "model: found joints of type free; expected a hinge"),
        ('<joint type="ball"/>', "model: found joints of type ball"),
    ],
)
def test_a_model_without_an_axis_is_refused(inside: str, message: str) -> None:
    with pytest.raises(DeclarationError, match=message):
        sero_mj.overlay(*compiled(XML.format(inside)))


def test_model_and_data_must_be_of_mujoco_and_of_each_other() -> None:
    model, data = arm()
    with pytest.raises(UsageError, match=r"model: found str; expected a compiled mujoco\.MjModel"):
        sero_mj.overlay("arm.xml", data)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match=r"data: found MjModel; expected mujoco.MjData\(model\)"):
        sero_mj.overlay(model, model)
    _, other = compiled(XML.format("<joint/>"))
    with pytest.raises(UsageError, match=r"model with nq = 1"):
        sero_mj.overlay(model, other)
    hinge, _ = compiled(XML.format("<joint/>"))
    _, slide = compiled(XML.format('<joint type="slide"/>'))
    with pytest.raises(UsageError, match="another jnt_type"):
        sero_mj.overlay(hinge, slide)
    sero_mj.overlay(model, mujoco.MjData(copy.copy(model)))  # one as good as its own


@pytest.mark.parametrize(
    ("target", "values", "error", "message"),
    [
        (
            "arm.torques",
            [1, 2],
            ValueError,
            r"arm.torques: found shape \(2,\); expected 4, one per",
        ),
        ("arm.torques", "high", ValueError, "arm.torques: found 'high'"),
        ("arm.torques", {"lft": 1}, UnknownName, "no joint of arm 'lft'; did you mean 'lift'?"),
        ("amr.torques", [0] * 4, UnknownName, "no robot 'amr'; did you mean 'arm'?"),
        ("arm.torque", [0] * 4, UnknownName, "no input of arm 'torque'; did you mean 'torques'?"),
        (
            "arm.joint_angles",
            [0] * 4,
            ValueError,
            "arm has the joint angles of your data; set data.q",
        ),
        ("arm.flange_check", np.ones((4, 4)), ValueError, "arm.flange_check: last row is"),
        ("arm.torques", None, ValueError, "arm.torques: found None"),
        ("arm.torques", "12", ValueError, "arm.torques: found '12'"),
        (
            "arm.arrow_quantity",
            "error",
            ValueError,
            "found 'error'; expected 1 number, or one",
        ),
        ("arm.show_axes", [1, 0], ValueError, r"found shape \(2,\); expected 1 number"),
    ],
)
def test_what_does_not_fit_is_said(
    overlay: Any, target: str, values: Any, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message.replace("?", r"\?")):
        overlay.set(target, values)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"robots": {"arn": {}}}, "no robot 'arn'; did you mean 'arm'"),
        ({"robots": {"arm": {"arow_radius": 1.0}}}, "robots.arm.arow_radius: unknown key; did you"),
        ({"robots": {"arm": {"dh_params": []}}}, "robots.arm.dh_params: unknown key"),
        ({"robots": {"arm": {"torque_limits": [1.0]}}}, "torque_limits: found 1 entries"),
        ({"robots": {"arm": {"arrow_radius": [1.0, 2]}}}, "arrow_radius: found 2 entries; expect"),
        (
            {"robots": {"arm": {"arrow_radius": -1.0}}},
            "arrow_radius: found -1; expected positive",
        ),
        ({"frames": ["tpi"]}, "no body or site 'tpi'; did you mean 'tip'"),
        ({"doubles": [sero_mj.Double(name="g", of="am")]}, "doubles.g.of: no robot 'am'; did you"),
        (
            {"arrows": [sero_mj.SmartArrow(name="p", at="arm/for")]},
            "arrows.p.at: no frame 'arm/for'",
        ),
    ],
)
def test_what_is_said_of_a_robot_must_fit_it(options: Any, message: str) -> None:
    with pytest.raises(SeroError, match=message):
        sero_mj.overlay(*arm(), **options)


def test_fields_of_a_robot_stand_over_what_the_model_says() -> None:
    said = {"torque_limits": [1.0, np.inf, 3.0, 4.0], "arrow_radius": 0.2, "show_axes": True}
    joints = sero_mj.overlay(*arm(), robots={"arm": said}).world.joints
    assert joints.torque_limit.tolist() == said["torque_limits"]
    assert joints.arrow_radius.tolist() == [0.2] * 4
    limited = sero_mj.overlay(*arm(), robots={"arm": {"torque_limits": 9.0}}).world.joints
    assert limited.torque_limit.tolist() == [9.0] * 4


def test_a_model_may_come_as_what_it_is_compiled_from_and_without_data() -> None:
    spec = mujoco.MjSpec.from_string(ARM)
    for model in (spec, spec.compile()):
        over = sero_mj.overlay(model)
        assert over.robots == {"arm": ["turn", "lift", "elbow", "grip"]}
        np.testing.assert_allclose(over.frame("arm/gripper")[:3, 3], arm()[1].body("gripper").xpos)


def test_entities_of_composer_are_taken() -> None:
    kinova = pytest.importorskip(
        "dm_control.entities.manipulators.kinova", reason="dm-control is not installed"
    )
    hand = kinova.JacoHand()
    over = sero_mj.overlay(hand)
    (joints,) = over.robots.values()
    assert joints == [joint.name for joint in hand.mjcf_model.find_all("joint")]


def test_the_quantity_of_arrows_is_set_by_its_name(overlay: Any) -> None:
    overlay.set("arm.arrow_quantity", "torque_error")
    overlay.image(64, 48)
    assert (overlay.toggles.arrow_quantity == 1).all()
