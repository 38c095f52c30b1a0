"""`overlay`: arrows, billboards, doubles and axes on any model that somebody else has compiled."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.cartesian import SmartArrow
from ..assemble.double import Double
from ..assemble.mjcf_piece import as_spec, is_mjcf_object
from ..assemble.scene import SceneToggles
from ..decor.picture_view import PictureView
from ..decor.toggles import Toggles
from ..errors import UsageError
from ..foreign.model_world import ModelWorld
from .camera import find_camera
from .canvas import canvas_of
from .headless.film import Picture
from .headless.renderer import DEFAULT_SIZE, HeadlessRenderer
from .interaction import Gesture, click, hover
from .picking import Picked
from .scene_decor import SceneDecor

log = logging.getLogger(__name__)


class Overlay:
    """Decor for a model and its data, which stay the user's and are never changed.

    Attributes:
        model: the user's.
        data: the user's; every frame shows it as it is, so call `mj_step` or `mj_forward` before.
        world: what was found in the model.
    """

    def __init__(self, world: ModelWorld) -> None:
        self.model, self.data, self.world = world.model, world.data, world
        self._decor = SceneDecor(world)
        self._drawn = self._decor  # what was drawn last: this, or that of a picture
        self._renderer: HeadlessRenderer | None = None

    @property
    def toggles(self) -> Toggles:
        """What is shown."""
        return self._decor.toggles

    @property
    def view(self) -> PictureView | None:
        """Of the frame drawn last; None before the first."""
        return self._drawn.view

    @property
    def dropped(self) -> int:
        """How many geoms found no room in that frame."""
        return self._drawn.dropped

    @property
    def robots(self) -> dict[str, list[str]]:
        """Names of the joints of every robot that was found."""
        return {name: part.robot.names for name, part in self.world.robots.items()}

    @property
    def not_finite(self) -> int:
        """How many values were set that are NaN or infinite; these are not shown."""
        return self.world.not_finite

    def set(self, target: str, values: Any) -> None:
        """Sets what is shown at joints, where a double stands, an arrow's vector, or a switch.

        Args:
            target: `arm.commanded_torques`, `arm.torques`, `goal.joint_angles`, `push.vector`,
                `arm.show_axes`, ...
            values: as many as it takes, SI units; for joints also a number by joint's name.

        Raises:
            UnknownName: no such input or joint; names the nearest.
            ValueError: they do not fit it.
        """
        self.world.set_input(self.data, target, values)

    def clear(self, target: str) -> None:
        """Takes back what was set: torques and accelerations are the model's own again."""
        self.world.clear_input(target)

    def frame(self, name: str) -> NDArray[np.float64]:
        """T_world_name (4, 4) of a frame (`arm/hand`), translation in m.

        Raises:
            UnknownName: no such frame.
        """
        return self.world.frame(self.data, name)

    def draw(self, target: Any, camera: Any = None, size: tuple[int, int] | None = None) -> int:
        """Adds everything that is switched on to a scene that MuJoCo has filled.

        Args:
            target: a `mujoco.Renderer` after `update_scene`, the viewer of
                `mujoco.viewer.launch_passive` (whose `user_scn` is cleared first), or an
                `MjvScene`.
            camera: where the scene has none: an `MjvCamera`, a camera's name, or
                `azimuth,elevation,distance` (degrees, degrees, m).
            size: width and height of the picture, pixels; of an `MjvScene` 640 x 480.

        Returns:
            how many geoms found no room; also in `dropped`.

        Raises:
            UsageError: it is none of these, or its camera is not known.
        """
        canvas = canvas_of(target, camera, size)
        scene = canvas.scene
        if canvas.camera is not None:
            look = canvas.camera
            if isinstance(look, str):
                look = find_camera(self.world, look)
            mujoco.mjv_updateCamera(self.model, self.data, look, scene)
        self._drawn = self._decor
        return self._decor.draw(
            self.data, PictureView.of_scene(scene, *canvas.size, canvas.font), scene
        )

    def pick(self, x: float, y: float, tolerance: float = 0.0) -> Picked | None:
        """Returns what is seen at a pixel of the frame drawn last, from its upper left corner.

        Args:
            x: to the right, pixels.
            y: down, pixels.
            tolerance: where no decor is hit, decor within so many pixels is.

        Raises:
            UsageError: nothing was drawn yet.
        """
        return self._drawn.pick(self.data, self._from_below(x, y), tolerance)

    def click(
        self, x: float, y: float, gesture: Gesture = "click", tolerance: float = 0.0
    ) -> Picked | None:
        """Clicks on a pixel and returns what was hit; the next frame shows it.

        Args:
            x: to the right, pixels.
            y: down, pixels.
            gesture: `click`, `shift` or `double`.
            tolerance: see `pick`.
        """
        picked = self.pick(x, y, tolerance)
        click(self.world, self.toggles, picked, gesture)
        return picked

    def hover(self, x: float, y: float) -> Picked | None:
        """Holds the pointer over a pixel: the name of what is there is written beside it."""
        picked = self.pick(x, y)
        hover(self.toggles, picked, self._from_below(x, y))
        return picked

    def _from_below(self, x: float, y: float) -> tuple[float, float]:
        if self.view is None:
            raise UsageError("nothing was drawn yet: call draw or image before")
        return x + 0.5, self.view.height - y - 0.5

    def image(
        self,
        width: int = DEFAULT_SIZE[0],
        height: int = DEFAULT_SIZE[1],
        camera: str | mujoco.MjvCamera | None = None,
    ) -> Picture:
        """Renders a picture without a window; a notebook shows it, `.save("out.png")` writes it.

        Args:
            width: pixels.
            height: pixels.
            camera: a camera's name, `azimuth,elevation,distance` (degrees, degrees, m), an
                `MjvCamera`, or None for a view of all robots.

        Raises:
            RenderError: no OpenGL, or the size is out of range.
            UnknownName: no camera of that name.
        """
        renderer = self._renderer
        if renderer is None or renderer.size != (width, height):
            self.close()
            renderer = self._renderer = HeadlessRenderer(self.world, width, height)
            renderer.toggles = self.toggles
        named = camera is None or isinstance(camera, str)
        renderer.camera = find_camera(self.world, camera) if named else camera
        picture: Picture = renderer.render(self.data).view(Picture)
        self._drawn = renderer.decor
        return picture

    def _repr_png_(self) -> bytes | None:
        """A picture, which notebooks ask for."""
        return self.image(*_NOTEBOOK_SIZE)._repr_png_()

    def close(self) -> None:
        """Frees the OpenGL context that `image` has made."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __enter__(self) -> Overlay:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


_NOTEBOOK_SIZE = (960, 600)


def overlay(
    model: Any,
    data: mujoco.MjData | None = None,
    *,
    robots: Mapping[str, Mapping[str, Any]] | None = None,
    doubles: Sequence[Double] = (),
    arrows: Sequence[SmartArrow] = (),
    frames: Sequence[str] = (),
    toggles: SceneToggles | None = None,
    name: str = "overlay",
) -> Overlay:
    """Finds the robots in a compiled model and returns their decor.

    A robot is what hangs below one child of the world and has a hinge or slide joint; it has the
    root body's name. Its arrows show `data.qfrc_actuator`, what the drives put out at the joints,
    until `ROBOT.torques` is set; `ROBOT.commanded_torques` have to be set. Full width is the
    limit of the joint or of the actuators on it; without one it is what gravity asks of the joint.
    Free and ball joints, which have no single axis, carry no arrow.

    Args:
        model: a `mujoco.MjModel`, which stays the user's and is not changed; or what one is
            compiled from: a `mujoco.MjSpec`, PyMJCF's `RootElement`, an entity of dm_control's
            composer.
        data: of that model, likewise; None for new data, in the overlay's `data`.
        robots: fields of robots, by name, over what the model says: `torque_limits`,
            `arrow_radius`, `axes_size`, `billboard_lines`, `show_axes`, ... as in `SerialRobot`.
        doubles: transparent doubles of its robots; only MuJoCo's classic renderer shows them.
        arrows: Cartesian vectors at frames (`arm/hand`).
        frames: other bodies and sites whose axes are shown.
        toggles: what is shown of all.
        name: in the window's title.

    Raises:
        UsageError: `data` belongs to another model, or these are something else.
        DeclarationError: the model has no hinge or slide joint, or a field does not fit it.
        UnknownName: no robot, body or site of that name; names the nearest.
    """
    if is_mjcf_object(model):
        model = as_spec(model, Path()).compile()
    _check_model(model)
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
            name=name,
        )
    )


def _check_model(model: Any) -> None:
    if not isinstance(model, mujoco.MjModel):
        raise UsageError(
            f"model: found {type(model).__name__}; expected a compiled mujoco.MjModel, as of "
            "mujoco.MjModel.from_xml_path, or an MjSpec or a PyMJCF model"
        )


def _check_data(model: mujoco.MjModel, data: Any) -> None:
    if not isinstance(data, mujoco.MjData):
        raise UsageError(f"data: found {type(data).__name__}; expected mujoco.MjData(model)")
    other = data.model
    if other is model:
        return
    for field in ("nq", "nv", "nbody", "njnt", "nsite", "ngeom", "nmocap"):
        found, expected = getattr(other, field), getattr(model, field)
        if found != expected:
            raise UsageError(
                f"data: found that of a model with {field} = {found}; expected {expected}: "
                "mujoco.MjData(model) of the same model"
            )
    for field in ("jnt_type", "jnt_bodyid", "body_parentid"):
        if not np.array_equal(getattr(other, field), getattr(model, field)):
            raise UsageError(
                f"data: found that of a model with another {field}; expected "
                "mujoco.MjData(model) of the same model"
            )
