"""`ImageView`: projection and its inverse, and against MuJoCo's camera."""

import mujoco
import numpy as np
import pytest
from decor_tools import view_at
from hypothesis import given
from hypothesis import strategies as st

from sero_mj.viewer.decor.image_view import ImageView


@given(
    st.floats(-3, 3), st.floats(0.3, 30), st.floats(0, 1280), st.floats(0, 800), st.floats(0.1, 9)
)
def test_point_at_a_pixel_is_projected_to_that_pixel(azimuth, distance, x, y, depth) -> None:
    view = view_at(azimuth, distance)
    point = view.at(np.array([[x, y]]), depth)
    pixels, depths = view.project(point)
    assert pixels[0] == pytest.approx([x, y], abs=1e-6)
    assert depths[0] == pytest.approx(depth)


def test_center_of_the_image_is_straight_ahead_and_up_is_up() -> None:
    view = view_at()
    ahead = view.position + 2.0 * view.forward
    pixels, _ = view.project(np.array([ahead, ahead + 0.1 * view.up, ahead + 0.1 * view.right]))
    assert pixels[0] == pytest.approx([640, 400])
    assert pixels[1][0] == pytest.approx(640)
    assert pixels[1][1] > 400
    assert pixels[2][0] > 640


def test_point_behind_the_eye_has_negative_depth() -> None:
    view = view_at()
    assert view.project(view.position - view.forward)[1] < 0


def test_pixel_size_is_the_distance_between_adjacent_pixels() -> None:
    view = view_at()
    points = view.at(np.array([[10.0, 20.0], [11.0, 20.0]]), 1.7)
    assert np.linalg.norm(points[1] - points[0]) == pytest.approx(view.pixel_size(1.7))


def test_view_of_a_scene_equals_the_mujoco_camera() -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><camera name="c" pos="1 -2 1.5" xyaxes="2 1 0 -.3 .6 2" fovy="33"/>'
        '<geom size=".1"/></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    scene = mujoco.MjvScene(model, 10)
    camera = mujoco.MjvCamera()
    camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
    mujoco.mjv_updateScene(
        model, data, mujoco.MjvOption(), None, camera, mujoco.mjtCatBit.mjCAT_ALL.value, scene
    )
    view = ImageView.of_scene(scene, 640, 480)
    assert view.position == pytest.approx(data.cam_xpos[0], abs=1e-6)
    assert view.facing == pytest.approx(data.cam_xmat[0].reshape(3, 3), abs=1e-6)
    assert 2 * np.arctan(view.tan_half_fovy) == pytest.approx(np.deg2rad(33), rel=1e-5)
