"""`ViewState`: the user's settings of a window or page, which commands and links contain."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Annotated, NamedTuple

import mujoco
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ...base.errors import SeroError, UsageError
from ...robots.assemble.world_view import WorldView
from ..decor.quantities import joint_name
from ..decor.toggles import Toggles
from ..image.camera import find_camera
from ..image.switches import SWITCH_NAMES, apply_switches, find_joint, switches_text
from .clock import Clock

_DECIMALS = 4  # number of decimals of angles in degrees and positions in m
_MAX_CHARACTERS = 200_000  # maximum length of the text; each switch of each joint has a digit
_MAX_TIME = 1e9  # s
_CAMERA = ("type", "fixedcamid", "trackbodyid", "azimuth", "elevation", "distance")
_SWITCHES = (*SWITCH_NAMES, "clicked")


class _Text(BaseModel):
    """JSON schema of a view state. The parser of pydantic limits the nesting."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    camera: str = ""
    switches: dict[str, str] = {}
    joint: str = ""
    time: Annotated[float, Field(gt=-_MAX_TIME, lt=_MAX_TIME)] | None = None


class ViewState(NamedTuple):
    """The user's settings of a window or page.

    Attributes:
        camera: camera in the format of `find_camera`, or an empty string for the scene's view.
        switches: switches that differ from the scene, in the format of `apply_switches`.
        joint: name of the selected joint, or an empty string.
        time: displayed time in seconds; None for live sources.
    """

    camera: str = ""
    switches: Mapping[str, str] = {}
    joint: str = ""
    time: float | None = None

    def to_text(self) -> str:
        """Returns the settings as one line of JSON, without default values."""
        found = {
            name: value for name, value in self._asdict().items() if value not in ("", {}, None)
        }
        return json.dumps(found, separators=(",", ":"))

    @classmethod
    def from_text(cls, text: str) -> ViewState:
        """Parses the text that `to_text` has returned.

        Raises:
            UsageError: the text is invalid.
        """
        if len(text) > _MAX_CHARACTERS:
            expected = f"at most {_MAX_CHARACTERS} characters"
            raise UsageError(f"view: found {len(text)} characters; expected {expected}")
        try:
            state = _Text.model_validate_json(text)
        except (ValidationError, UnicodeEncodeError) as error:
            reason = str(error)
            if isinstance(error, ValidationError):
                first = error.errors(include_url=False, include_input=False)[0]
                reason = ": ".join([*map(str, first["loc"]), first["msg"]])
            raise UsageError(f"view: {text[:60]!r} is not a valid view: {reason}") from None
        return cls(state.camera, state.switches, state.joint, state.time)


def view_state_of(
    world: WorldView, camera: mujoco.MjvCamera, toggles: Toggles, clock: Clock
) -> ViewState:
    """Returns the current camera, switches, selection and time as a `ViewState`."""
    return ViewState(
        camera_text(world, camera),
        switches_text(world, toggles),
        "" if toggles.selected is None else joint_name(world, toggles.selected),
        None if clock.is_live else round(clock.time, 6),  # Arrows rotate with time.
    )


def camera_text(world: WorldView, camera: mujoco.MjvCamera) -> str:
    """Formats a camera for `find_camera`, as the camera's name or as six numbers."""
    if int(camera.type) == int(mujoco.mjtCamera.mjCAMERA_FIXED):
        return str(world.model.camera(camera.fixedcamid).name)
    numbers = (camera.azimuth, camera.elevation, camera.distance, *camera.lookat)
    return ",".join(f"{round(float(number), _DECIMALS) + 0.0:.10g}" for number in numbers)


def apply_state(
    world: WorldView, toggles: Toggles, state: ViewState
) -> tuple[mujoco.MjvCamera | None, int | None, list[str]]:
    """Applies a view state to the switches of a world. Invalid settings are skipped.

    Returns:
        the camera, or None for the scene's view; the index of the selected joint, or None; and one
        error message for each invalid setting.
    """
    errors: list[str] = []
    camera = None
    toggles.reset()
    for name, digits in state.switches.items():
        try:
            apply_switches(world, toggles, {name: digits})
        except SeroError as error:
            errors.append(str(error))
    if state.camera:
        try:
            camera = find_camera(world, state.camera)
        except SeroError as error:
            errors.append(str(error))
    toggles.selected = None
    if state.joint:
        try:
            toggles.selected = find_joint(world, state.joint)
        except SeroError as error:
            errors.append(str(error))
    return camera, toggles.selected, errors


class ViewSnapshot(NamedTuple):
    """The exact camera, switches and selection of a window or page, which undo restores.

    Attributes:
        camera: type, camera id, body id, azimuth, elevation and distance of the camera.
        lookat: look-at point, shape (3,), m; None if the camera follows a frame.
    """

    camera: tuple[float, ...]
    lookat: tuple[float, ...] | None
    switches: tuple[bytes, ...]
    selected: int | None

    @classmethod
    def of(cls, camera: mujoco.MjvCamera, toggles: Toggles, *, follows: bool) -> ViewSnapshot:
        return cls(
            tuple(getattr(camera, name) for name in _CAMERA),
            None if follows else tuple(camera.lookat.tolist()),
            tuple(np.asarray(getattr(toggles, name)).tobytes() for name in _SWITCHES),
            toggles.selected,
        )

    def show(self, camera: mujoco.MjvCamera, toggles: Toggles) -> None:
        for name, value in zip(_CAMERA, self.camera, strict=True):
            setattr(camera, name, value)
        if self.lookat is not None:
            camera.lookat = self.lookat
        for name, stored in zip(_SWITCHES, self.switches, strict=True):
            now = getattr(toggles, name)
            if isinstance(now, int):
                (value,) = np.frombuffer(stored, np.asarray(now).dtype).tolist()
                setattr(toggles, name, value)
            else:
                now[:] = np.frombuffer(stored, now.dtype)
        toggles.selected = self.selected
