"""`overlay`: draws arrows, billboards, transparent doubles and axes on any MuJoCo model."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import mujoco
import numpy as np

from ...base.errors import Problem, UsageError
from ...base.frames import Array
from ...robots.declared.cartesian import SmartArrow
from ...robots.declared.double import Double
from ...robots.declared.scene import SceneToggles
from ...robots.external.model_world import ModelWorld
from ...robots.importers.mjcf_file import as_spec, is_mjcf_object
from ..decor.font import DEFAULT_FONT, Font
from ..decor.image_view import ImageView
from ..decor.toggles import Toggles
from ..image.backend import adopt_backend
from ..image.camera import find_camera
from ..image.clicks import Gesture
from ..image.image_files import ImageArray
from ..image.image_options import DEFAULT_SIZE
from ..image.mujoco_private import context_of, lend_shapes_to
from ..image.picking import Picked, Pixel
from ..image.render import HeadlessRenderer
from ..image.scene_decor import SceneDecor
from .robot_inputs import RobotInputs

log = logging.getLogger(__name__)

_NOTEBOOK_SIZE = (960, 600)
_SCENE_SIZE = (640, 480)  # image size in pixels that is assumed for a scene without one


class Overlay:
    """Draws arrows, billboards, doubles and axes on a user's model, without changing the model.

    Attributes:
        model: the user's model.
        data: the user's data, which is not changed either. Frames show its current state, so call
            `mj_step` or `mj_forward` before drawing.
    """

    def __init__(self, world: ModelWorld) -> None:
        self.model, self.data, self.world = world.model, world.data, world
        self._decor = SceneDecor(world)
        self._drawn = self._decor  # decor of the last frame; `image` draws with another one
        self._renderer: HeadlessRenderer | None = None
        self._first_shapes: WeakKeyDictionary[mujoco.Renderer, int] = WeakKeyDictionary()
        self._has_warned = False

    @property
    def toggles(self) -> Toggles:
        return self._decor.toggles

    @property
    def view(self) -> ImageView | None:
        return self._drawn.view

    @property
    def dropped(self) -> int:
        return self._drawn.dropped

    @property
    def robots(self) -> dict[str, list[str]]:
        return {name: part.robot.names for name, part in self.world.robots.items()}

    @property
    def not_finite(self) -> int:
        """Number of NaN, infinite and implausible values that were set, but are not displayed."""
        return self.world.not_finite

    def set(self, target: str, values: Any) -> None:
        """Sets an input: joint values, a double's joint angles, an arrow's vector, or a switch.

        Args:
            target: name of the input, such as `arm.commanded_torques`, `arm.torques`,
                `goal.joint_angles`, `push.vector` or `arm.show_axes`.
            values: values in the shape of the input, in SI units. Joint values can also be a vector
                for the whole model, shape (nv,), or a mapping from joint names to values.

        Raises:
            UnknownName: there is no such input or joint. The message suggests a similar name.
            ValueError: the values do not have the shape or range of the input.
        """
        self.world.set_input(self.data, target, values)

    def robot(self, name: str) -> RobotInputs:
        """Returns the inputs of a robot or double as attributes: `robot("arm").torques = ...`.

        Raises:
            UnknownName: there is no such robot or double. The message suggests a similar name.
        """
        return RobotInputs(self, name)

    def clear(self, target: str) -> None:
        """Clears an input. Torques and joint accelerations are then taken from `data` again."""
        self.world.clear_input(target)

    def frame(self, name: str) -> Array:
        """Returns the pose of a frame, such as `arm/hand`, in the world.

        Returns:
            homogeneous transform T_world_frame, shape (4, 4), with the translation in m.

        Raises:
            UnknownName: there is no such frame.
        """
        return self.world.frame(self.data, name)

    def draw(self, target: Any, camera: Any = None, size: tuple[int, int] | None = None) -> int:
        """Adds arrows, billboards, doubles and axes to a scene that MuJoCo has filled.

        Args:
            target: a `mujoco.Renderer` after `update_scene`, an `MjvScene`, or the viewer of
                `mujoco.viewer.launch_passive`, whose `user_scn` is cleared first.
            camera: camera for a scene without one: an `MjvCamera`, a camera's name, or
                `azimuth,elevation,distance` (degrees, degrees, m).
            size: width and height of the image in pixels; None for the size of the target.

        Returns:
            number of geoms that exceeded the capacity of the scene, also stored in `dropped`.

        Raises:
            UsageError: the target has another type, or the camera is unknown.
        """
        scene, font, own_camera, own_size = _canvas_of(target)
        camera = own_camera if camera is None else camera
        width, height = size or own_size
        if not (width > 0 and height > 0):
            found = f"found {width} x {height}"
            raise UsageError(Problem("size", found, expected="a size above 0"))
        if camera is not None:
            look = find_camera(self.world, camera) if isinstance(camera, str) else camera
            mujoco.mjv_updateCamera(self.model, self.data, look, scene)
        elif not scene.camera[0].frustum_near > 0:
            raise UsageError(
                "the scene has no camera yet: call update_scene first, or pass a camera to draw"
            )
        self.check_frames()
        self._drawn = self._decor
        self._decor.first_shape = self._first_shape(target)
        view = ImageView.of_scene(scene, width, height, font)
        return self._decor.draw(self.data, view, scene)

    def _first_shape(self, target: Any) -> int | None:
        if not isinstance(target, mujoco.Renderer):
            return None
        if target not in self._first_shapes:
            self._first_shapes[target] = lend_shapes_to(target)
        return self._first_shapes[target]

    def pick(self, x: float, y: float, tolerance: float = 0.0) -> Picked | None:
        """Returns the item at a pixel of the last frame, or None if there is none.

        Args:
            x: distance of the pixel from the left edge of the image.
            y: distance of the pixel from the upper edge of the image.
            tolerance: maximum distance in pixels from an arrow, billboard or other item that is not
                part of the model, if no item is hit exactly.

        Raises:
            UsageError: nothing has been drawn yet.
        """
        return self._drawn.pick(self.data, self._from_above(x, y), tolerance)

    def click(
        self, x: float, y: float, gesture: Gesture = "click", tolerance: float = 0.0
    ) -> Picked | None:
        return self._drawn.click(self.data, self._from_above(x, y), gesture, tolerance)

    def hover(self, x: float, y: float) -> Picked | None:
        return self._drawn.hover(self.data, self._from_above(x, y))

    def _from_above(self, x: float, y: float) -> Pixel:
        if self.view is None:
            raise UsageError("nothing has been drawn yet: call draw or image first")
        return self._drawn.from_above(x, y)

    def image(
        self,
        width: int = DEFAULT_SIZE[0],
        height: int = DEFAULT_SIZE[1],
        camera: str | mujoco.MjvCamera | None = None,
    ) -> ImageArray:
        """Renders an image without a window.

        Notebooks display the returned image, and its method `save("out.png")` writes a file.

        Args:
            width: width of the image in pixels.
            height: height of the image in pixels.
            camera: a camera's name, `azimuth,elevation,distance` (degrees, degrees, m), an
                `MjvCamera`, or None for a view of all robots.

        Raises:
            RenderError: OpenGL is not available, or the size is out of range.
            UsageError: the size is not a number.
            UnknownName: there is no camera with this name.
        """
        for key, value in (("width", width), ("height", height)):
            if not isinstance(value, int | np.integer):
                raise UsageError(Problem(key, found=value, expected="a number of pixels"))
        self.check_frames()
        renderer = self._renderer
        if renderer is None or renderer.size != (width, height):
            self.close()
            renderer = self._renderer = HeadlessRenderer(self.world, width, height)
            renderer.toggles = self.toggles
        named = camera is None or isinstance(camera, str)
        renderer.camera = find_camera(self.world, camera) if named else camera
        image: ImageArray = renderer.render(self.data).view(ImageArray)
        self._drawn = renderer.decor
        return image

    def check_frames(self) -> None:
        """Logs a warning, only once, if `mj_forward` has not been called for the data."""
        if not self._has_warned and not self.data.xmat.any():
            self._has_warned = True
            log.warning(
                "the data of %s has no frames yet, so everything is at the origin: call "
                "mujoco.mj_forward(model, data) before drawing",
                self.world.scene.name,
            )

    def _repr_png_(self) -> bytes | None:
        return self.image(*_NOTEBOOK_SIZE)._repr_png_()

    def __repr__(self) -> str:
        found = ", ".join(f"{name} ({len(joints)} joints)" for name, joints in self.robots.items())
        return f"Overlay of {found}"

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __enter__(self) -> Overlay:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def _canvas_of(target: Any) -> tuple[mujoco.MjvScene, Font, Any, tuple[int, int]]:
    if isinstance(target, mujoco.MjvScene):
        return target, DEFAULT_FONT, None, _SCENE_SIZE
    if isinstance(target, mujoco.Renderer):
        return (
            target.scene,
            Font.of_context(context_of(target)),
            None,
            (target.width, target.height),
        )
    if getattr(target, "user_scn", None) is not None and hasattr(target, "cam"):
        view = target.viewport
        size = _SCENE_SIZE if view is None else (int(view.width), int(view.height))
        target.user_scn.ngeom = 0  # MuJoCo does not clear the geoms of the last frame.
        return target.user_scn, DEFAULT_FONT, target.cam, size
    expected = "a mujoco.Renderer, a viewer of mujoco.viewer.launch_passive, or a mujoco.MjvScene"
    raise UsageError(Problem("", f"found {type(target).__name__}", expected=expected))


def overlay(
    model: Any,
    data: mujoco.MjData | None = None,
    *,
    robots: Mapping[str, Mapping[str, Any]] | None = None,
    doubles: Sequence[Double] = (),
    arrows: Sequence[SmartArrow] = (),
    frames: Sequence[str] = (),
    toggles: SceneToggles | None = None,
    surroundings: bool = True,
    name: str = "overlay",
) -> Overlay:
    """Finds the robots in a compiled model, and returns an overlay that draws their features.

    A robot is a kinematic tree: a child body of the world and all its descendants, with at least
    one hinge or slide joint. If the model has actuators, one of them must drive the tree, or
    `robots` must contain its name. Limbs of a trunk that is fused with the world form one robot. A
    robot is named after its root body, or after the model if the root body has a name such as
    `base_link`.

    Arrows show `data.qfrc_actuator`, the actuator forces at the joints, until `ROBOT.torques` is
    set. `ROBOT.commanded_torques` has no default. Arrows have full width at the limit of the joint
    or its actuators, or at the gravity load of the joint if there is no limit. Free and ball joints
    have no arrow.

    Args:
        model: a `mujoco.MjModel`, which is not changed, or a model to compile: a `mujoco.MjSpec`,
            a PyMJCF `RootElement`, or a dm_control composer entity.
        data: data of the model, which is not changed; None to create the data.
        robots: mapping from robot names to fields of `SerialRobot` that override the model, such as
            `torque_limits`, `arrow_radius`, `axes_size`, `billboard_lines` or `show_axes`.
        doubles: transparent doubles of robots of the model.
        arrows: Cartesian vectors at frames, such as `arm/hand`.
        frames: names of other bodies and sites whose axes are shown.
        toggles: initial switches of the whole scene.
        surroundings: whether `image` and windows add a floor, a sky and lights if the model has
            none. Other renderers and pages show only the surroundings of the model.
        name: title of the window.

    Raises:
        UsageError: `data` belongs to another model, or an argument has a wrong type.
        DeclarationError: the model has no hinge or slide joint, or a field is invalid for it.
        UnknownName: there is no such robot, body or site. The message suggests a similar name.
    """
    if is_mjcf_object(model):
        model = as_spec(model, Path()).compile()
    _check_model(model)
    if robots is not None and not isinstance(robots, Mapping):
        expected = "a mapping from robots to fields, such as {'arm': {'arrow_radius': 0.06}}"
        raise UsageError(Problem("robots", found=robots, expected=expected))
    if isinstance(frames, str):
        frames = [frames]
    adopt_backend()  # A renderer that the user has created needs it, too.
    if data is None:
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
    _check_data(model, data)
    return Overlay(
        ModelWorld(
            model,
            data,
            robots=robots,
            doubles=doubles,
            arrows=arrows,
            frames=frames,
            toggles=toggles,
            surroundings=surroundings,
            name=name,
        )
    )


def _check_model(model: Any) -> None:
    if not isinstance(model, mujoco.MjModel):
        expected = (
            "a compiled mujoco.MjModel, for example from mujoco.MjModel.from_xml_path, an MjSpec "
            "or a PyMJCF model"
        )
        raise UsageError(Problem("model", f"found {type(model).__name__}", expected=expected))


def _check_data(model: mujoco.MjModel, data: Any) -> None:
    if not isinstance(data, mujoco.MjData):
        found = f"found {type(data).__name__}"
        raise UsageError(Problem("data", found, expected="mujoco.MjData(model)"))
    other = data.model
    if other is model:
        return
    for field in ("nq", "nv", "nbody", "njnt", "nsite", "ngeom", "nmocap"):
        found, expected = getattr(other, field), getattr(model, field)
        if found != expected:
            problem = Problem(
                "data",
                f"found data of a model with {field} =",
                found=found,
                expected=f"{expected}, as in mujoco.MjData(model)",
            )
            raise UsageError(problem)
    for field in ("jnt_type", "jnt_bodyid", "body_parentid"):
        if not np.array_equal(getattr(other, field), getattr(model, field)):
            found = f"found data of a model with another {field}"
            expected = "data of the same model, created with mujoco.MjData(model)"
            raise UsageError(Problem("data", found, expected=expected))
