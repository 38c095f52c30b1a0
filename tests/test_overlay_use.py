"""`overlay` in the user's own loop: drawing targets, and errors for wrong use."""

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
from sero_mj.base.errors import DeclarationError, UnknownName, UsageError


@pytest.fixture
def overlay() -> Any:
    return sero_mj.overlay(*arm())


def scene_of(overlay: Any, maxgeom: int = 2000) -> mujoco.MjvScene:
    """Returns a scene filled by MuJoCo, like those of renderers."""
    scene = mujoco.MjvScene(overlay.model, maxgeom=maxgeom)
    camera = mujoco.MjvCamera()
    camera.distance, camera.lookat = 2.0, (0, 0, 0.4)
    mujoco.mjv_updateScene(
        overlay.model, overlay.data, mujoco.MjvOption(), None, camera,
        mujoco.mjtCatBit.mjCAT_ALL, scene,
    )  # fmt: skip
    return scene


def test_draw_appends_geoms_to_those_of_a_scene(overlay: Any) -> None:
    scene = scene_of(overlay)
    own = [(geom.objid, geom.pos.tolist()) for geom in scene.geoms[: scene.ngeom]]
    assert overlay.draw(scene, size=(800, 600)) == 0
    assert scene.ngeom > len(own) + 50
    assert [(geom.objid, geom.pos.tolist()) for geom in scene.geoms[: len(own)]] == own
    kinds = {geom.category for geom in scene.geoms[len(own) : scene.ngeom]}
    assert kinds == {int(mujoco.mjtCatBit.mjCAT_DECOR)}


@pytest.mark.parametrize("room", [0, 1, 30])
def test_geoms_over_capacity_are_counted_and_reported_once(
    overlay: Any, room: int, caplog: Any
) -> None:
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
    assert f"{left_out} geoms of arrows, axes or panels are not drawn" in caplog.text
    assert f"the scene has room for {scene.maxgeom} geoms" in caplog.text


@pytest.mark.parametrize("room", [0, 2])
def test_double_over_capacity_is_counted(room: int) -> None:
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


def test_passive_viewer_is_drawn_from_its_own_camera(overlay: Any) -> None:
    """Its handle in 4.0: `user_scn` has no camera, and `cam` is the user's view."""
    camera = mujoco.MjvCamera()
    camera.distance, camera.azimuth, camera.elevation = 2.0, 90.0, -20.0
    handle = SimpleNamespace(
        user_scn=mujoco.MjvScene(overlay.model, maxgeom=2000),
        cam=camera,
        viewport=mujoco.MjrRect(0, 0, 800, 500),
    )
    for _ in range(3):  # nothing else clears it
        overlay.draw(handle)
        first = handle.user_scn.ngeom
    assert first < 500
    assert (overlay.view.width, overlay.view.height) == (800, 500)
    assert overlay.view.forward == pytest.approx(
        [0, np.cos(np.deg2rad(20)), -np.sin(np.deg2rad(20))], abs=1e-6
    )


def test_camera_can_be_a_string(overlay: Any) -> None:
    scene = mujoco.MjvScene(overlay.model, maxgeom=2000)
    overlay.draw(scene, camera="90,0,3")
    assert overlay.view.forward == pytest.approx([0, 1, 0], abs=1e-6)
    with raises_with(UnknownName, kind="camera", name="side"):
        overlay.draw(scene, camera="side")


def test_different_scenes_can_be_drawn_in_turn(overlay: Any) -> None:
    one, other = scene_of(overlay), scene_of(overlay)
    before = one.ngeom
    overlay.draw(one)
    overlay.draw(other)
    assert one.ngeom == other.ngeom > before


@pytest.mark.parametrize(
    ("target", "reason"),
    [
        (None, "found NoneType"),
        (SimpleNamespace(user_scn=None, cam=None), "found SimpleNamespace"),
    ],
)
def test_invalid_drawing_target_is_rejected(overlay: Any, target: Any, reason: str) -> None:
    expected = "a mujoco.Renderer, a viewer of mujoco.viewer.launch_passive, or a mujoco.MjvScene"
    with raises_with(UsageError, reason=reason, expected=expected):
        overlay.draw(target)


def test_scene_without_a_camera_is_rejected(overlay: Any) -> None:
    needed = "call update_scene first, or pass a camera to draw"
    with raises_with(UsageError, reason=f"the scene has no camera yet: {needed}"):
        overlay.draw(mujoco.MjvScene(overlay.model, maxgeom=100))


def test_size_must_be_positive_and_a_click_needs_a_frame(overlay: Any) -> None:
    with raises_with(UsageError, key="size", reason="found 0 x 480", expected="a size above 0"):
        overlay.draw(scene_of(overlay), size=(0, 480))
    with raises_with(UsageError, reason="nothing has been drawn yet: call draw or image first"):
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
def test_model_without_an_axis_is_rejected(inside: str, message: str) -> None:
    with pytest.raises(DeclarationError, match=message):
        sero_mj.overlay(*compiled(XML.format(inside)))


def test_model_and_data_must_be_mujoco_objects_of_the_same_model() -> None:
    model, data = arm()
    with raises_with(
        UsageError,
        key="model",
        reason="found str",
        expected=(
            "a compiled mujoco.MjModel, for example from mujoco.MjModel.from_xml_path, an "
            "MjSpec or a PyMJCF model"
        ),
    ):
        sero_mj.overlay("arm.xml", data)  # type: ignore[arg-type]
    with raises_with(
        UsageError, key="data", reason="found MjModel", expected="mujoco.MjData(model)"
    ):
        sero_mj.overlay(model, model)
    _, other = compiled(XML.format("<joint/>"))
    with raises_with(
        UsageError,
        key="data",
        reason="found data of a model with nq =",
        found=1,
        expected="11, as in mujoco.MjData(model)",
    ):
        sero_mj.overlay(model, other)
    hinge, _ = compiled(XML.format("<joint/>"))
    _, slide = compiled(XML.format('<joint type="slide"/>'))
    with raises_with(
        UsageError,
        key="data",
        reason="found data of a model with another jnt_type",
        expected="data of the same model, created with mujoco.MjData(model)",
    ):
        sero_mj.overlay(hinge, slide)
    sero_mj.overlay(model, mujoco.MjData(copy.copy(model)))  # an equal copy is accepted


TORQUES = "4, one per joint: shape (4,), or one per degree of freedom of the model: shape (10,)"


@pytest.mark.parametrize(
    ("target", "values", "expected"),
    [
        ("arm.torques", [1, 2], {"reason": "found shape", "found": (2,), "expected": TORQUES}),
        ("arm.torques", "high", {"found": "high", "expected": TORQUES}),
        ("arm.torques", None, {"found": None, "expected": TORQUES}),
        ("arm.torques", "12", {"found": "12", "expected": TORQUES}),
        (
            "arm.flange_check",
            np.ones((4, 4)),
            {"reason": "last row is", "found": [1.0] * 4, "expected": "[0, 0, 0, 1] (row-major)"},
        ),
        (
            "arm.arrow_quantity",
            "error",
            {
                "found": "error",
                "expected": "1 number, or one of torques, torque_error, joint_accelerations, "
                "singularity, torque_without_gravity, torque_without_friction",
            },
        ),
        (
            "arm.show_axes",
            [1, 0],
            {"reason": "found shape", "found": (2,), "expected": "1 number"},
        ),
    ],
)
def test_values_of_the_wrong_shape_are_rejected(
    overlay: Any, target: str, values: Any, expected: dict[str, Any]
) -> None:
    with raises_with(key=target, **expected):
        overlay.set(target, values)


@pytest.mark.parametrize(
    ("target", "values", "kind", "name", "near"),
    [
        ("arm.torques", {"lft": 1}, "joint of arm", "lft", "lift"),
        ("amr.torques", [0] * 4, "robot", "amr", "arm"),
        ("arm.torque", [0] * 4, "input of arm", "torque", "torques"),
    ],
)
def test_unknown_names_are_rejected(
    overlay: Any, target: str, values: Any, kind: str, name: str, near: str
) -> None:
    with raises_with(UnknownName, kind=kind, name=name, near=near):
        overlay.set(target, values)


def test_joint_angles_cannot_be_set_on_an_overlay(overlay: Any) -> None:
    message = (
        r"^arm\.joint_angles: the joint angles of arm come from your data. Set data\.qpos instead$"
    )
    with pytest.raises(ValueError, match=message):
        overlay.set("arm.joint_angles", [0] * 4)


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("arow_radius", 1.0, {"reason": "unknown key", "near": "arrow_radius"}),
        ("dh_params", [], {"reason": "unknown key"}),
        (
            "torque_limits",
            [1.0],
            {"found": 1, "of": "entries", "expected": "4, one per frame of joint_frames"},
        ),
        (
            "arrow_radius",
            [1.0, 2],
            {"found": 2, "of": "entries", "expected": "4, one per joint"},
        ),
        ("arrow_radius", -1.0, {"found": -1.0, "expected": "positive numbers"}),
    ],
)
def test_invalid_robot_fields_are_rejected(
    field: str, value: Any, expected: dict[str, Any]
) -> None:
    with raises_with(key=f"robots.arm.{field}", **expected):
        sero_mj.overlay(*arm(), robots={"arm": {field: value}})


def test_unknown_robots_frames_doubles_and_arrows_are_rejected() -> None:
    with raises_with(UnknownName, kind="robot", name="arn", near="arm"):
        sero_mj.overlay(*arm(), robots={"arn": {}})
    with raises_with(UnknownName, kind="body or site", name="tpi", near="tip"):
        sero_mj.overlay(*arm(), frames=["tpi"])
    with raises_with(key="doubles.g.of", reason="no robot", found="am", near="arm"):
        sero_mj.overlay(*arm(), doubles=[sero_mj.Double(name="g", of="am")])
    with raises_with(key="arrows.p.at", reason="no frame 'arm/for'; did you mean 'arm/fore'?"):
        sero_mj.overlay(*arm(), arrows=[sero_mj.SmartArrow(name="p", at="arm/for")])


def test_robot_fields_override_those_of_the_model() -> None:
    said = {"torque_limits": [1.0, np.inf, 3.0, 4.0], "arrow_radius": 0.2, "show_axes": True}
    joints = sero_mj.overlay(*arm(), robots={"arm": said}).world.joints
    assert joints.torque_limit.tolist() == said["torque_limits"]
    assert joints.arrow_radius.tolist() == [0.2] * 4
    limited = sero_mj.overlay(*arm(), robots={"arm": {"torque_limits": 9.0}}).world.joints
    assert limited.torque_limit.tolist() == [9.0] * 4


def test_model_can_be_a_spec_and_data_can_be_omitted() -> None:
    spec = mujoco.MjSpec.from_string(ARM)
    for model in (spec, spec.compile()):
        over = sero_mj.overlay(model)
        assert over.robots == {"arm": ["turn", "lift", "elbow", "grip"]}
        np.testing.assert_allclose(over.frame("arm/gripper")[:3, 3], arm()[1].body("gripper").xpos)


def test_composer_entities_are_accepted() -> None:
    kinova = pytest.importorskip(
        "dm_control.entities.manipulators.kinova", reason="dm-control is not installed"
    )
    hand = kinova.JacoHand()
    over = sero_mj.overlay(hand)
    (joints,) = over.robots.values()
    assert joints == [joint.name for joint in hand.mjcf_model.find_all("joint")]


def test_arrow_quantity_is_set_by_name(overlay: Any) -> None:
    overlay.set("arm.arrow_quantity", "torque_error")
    overlay.image(64, 48)
    assert (overlay.toggles.arrow_quantity == 1).all()
