"""Captures poses, values and overlays of each frame of a scene for the player, without OpenGL.

The player places everything that depends on the camera, such as billboards.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import mujoco
import numpy as np

from ...base.errors import RenderError
from ...base.frames import Array, Bools, Ints
from ...data.drive.mirror import Mirror, restore
from ...robots.assemble.world import World
from ...robots.assemble.world_view import WorldView
from ...robots.declared.double import OUT_OF_SIGHT
from ...robots.declared.scene import Scene
from ..decor.billboards import LineFormat, has_chosen_lines, joint_formats, shows_errors
from ..decor.draw import Decor
from ..decor.geom_buffer import GEOM, Kind
from ..decor.image_view import ImageView
from ..decor.legend import Legend
from ..decor.quantities import joint_name
from ..decor.toggles import Toggles
from ..image.camera import Follower, find_camera, followed
from ..image.framing import Framing, declared_data, needed_aspect
from ..image.held_torques import HeldTorques
from ..image.image_options import DEFAULT_SIZE
from ..image.sampling import known_poses, sampled_states
from .copied_bodies import CopiedBody
from .frame import CapturedFrame, FrameTaker, body_poses, shown_bodies
from .model import visible_geoms
from .packing import types_of
from .soft import Soft, SoftParts, bytes_of_frame, soft_of

DEFAULT_FPS = 30.0
DEFAULT_SECONDS = 10.0  # duration of a captured run if the sources have no end
MAX_BYTES = 128_000_000  # maximum size of a run in the browser's memory
_LABEL = int(mujoco.mjtGeom.mjGEOM_LABEL)
_SIZE = (1280, 800)  # assumed size of the image in pixels, on which some features depend


@dataclass(frozen=True)
class MarkPlot:
    """Residuals of a joint over time, and over the quantity that explains them; None if unknown.

    Attributes:
        joint: name of the joint, such as `lwr/A4`.
        notes: lines below the plots.
        label: name and unit of the residuals.
        times: times in seconds since the start of the page, length K.
        before: residuals without the explanation, length K.
        after: residuals with the explanation, length K.
        quantity: name and unit of the quantity.
        unit: unit of the quantity.
        values: values of the quantity, length K.
        fit: values of the quantity and explained torques, as pairs in ascending order.
    """

    joint: str
    notes: Sequence[str]
    label: str
    times: Sequence[float]
    before: Sequence[float | None]
    after: Sequence[float | None]
    quantity: str
    unit: str
    values: Sequence[float | None]
    fit: Sequence[tuple[float, float]]


@dataclass(frozen=True)
class Mark:
    """An event on the timeline of an exported page.

    Attributes:
        begin: start time of the event in seconds since the start of the page.
        end: end time of the event in seconds; equal to `begin` for an instant.
        text: description of the event.
        kind: origin of the event: `push` or `fault` of a scenario, `finding` of a monitor,
            `bookmark` of the user, or `held` or `failed` for an expectation.
        plot: plots that the page shows for the mark; None for none.
    """

    begin: float
    end: float
    text: str
    kind: Literal["push", "fault", "finding", "bookmark", "held", "failed"]
    plot: MarkPlot | None = None


@dataclass(frozen=True, eq=False)
class DecorItem:
    """A geom of an arrow, frame or other overlay in all F frames of a run.

    Attributes:
        kind: kind of the item that the geom belongs to.
        item: index of the item among the items of its kind.
        rows: state of the geom in each frame, shape (F,), dtype `GEOM`.
        visible: mask of the frames that show the geom, shape (F,), bool.
    """

    kind: Kind
    item: int
    rows: np.ndarray
    visible: np.ndarray


@dataclass(eq=False)
class CapturedRun:
    """F captured frames of a scene, which the player can display in a browser.

    The arrays are those of `CapturedFrame` with an additional first axis for the frames.

    Attributes:
        fps: frames per second.
        begin: time of the first frame in seconds.
        toggles: initial switches.
        camera: initial camera.
        lines: billboard lines of each joint, length N.
        details: lines with all values of each joint, length N.
        bodies: ids of the visible bodies, shape (B,).
        copies: bodies of doubles, length G. In poses, opacity and grey, they come after `bodies`.
        limit: joint values at which arrows have full width, shape (N,); inf for no limit.
        arrow_texts: mapping from the indices of smart arrows to a list with one text per frame.
        silent: names of the sources without data.
        meanings: mapping from labels on billboards to meanings, such as `A` to a file name.
        needed: minimum aspect ratio (width over height) of images from the camera, see
            `needed_aspect`; None to compute it from the declared pose.
        path: displacement of a camera that follows a frame, shape (F, 3), m; otherwise None.
    """

    world: WorldView
    fps: float
    begin: float
    toggles: Toggles
    camera: mujoco.MjvCamera
    lines: list[list[LineFormat]]
    details: list[list[LineFormat]]
    bodies: Ints
    positions: Array
    rotations: Array
    opacity: Array
    grey: np.ndarray
    values: dict[str, Array]
    arrows: Array
    limit: Array
    stale: np.ndarray
    soft: Soft
    items: list[DecorItem]
    labels: list[Any]
    notes: list[str]
    legend: list[str]
    arrow_texts: dict[int, list[str]]
    marks: Sequence[Mark] = ()
    silent: list[str] = field(default_factory=list)
    meanings: Mapping[str, str] = field(default_factory=dict)
    copies: Sequence[CopiedBody] = ()
    needed: float | None = None
    path: Array | None = None

    @property
    def frames(self) -> int:
        return len(self.positions)

    @property
    def joint_names(self) -> list[str]:
        return [joint_name(self.world, i) for i in range(len(self.world.joints.names))]

    @property
    def geoms(self) -> Ints:
        return visible_geoms(self.world.model)


class FrameCapturer:
    """Captures states of a world one by one, without joint arrows, which the player draws."""

    def __init__(self, world: WorldView, camera: mujoco.MjvCamera) -> None:
        self._world, self._camera = world, camera
        self.toggles = Toggles(world)
        self.toggles.billboards[:] = False
        self.toggles.doubles[:] = self.toggles.cards[:] = True
        self._decor = Decor(world)
        for feature in self._decor.features:
            if isinstance(feature, Legend):
                feature.is_steady = False
        self._taker = FrameTaker(world, np.ones(len(world.joints.names), bool))
        self._decor.features.append(self._taker)
        self._view: ImageView | None = None

    def take(self, data: mujoco.MjData) -> CapturedFrame:
        if self._view is None:
            self._view = _view(self._world.model, data, self._camera)
        self._decor.draw(data, self.toggles, self._view)
        return self._taker.take(data)

    def pose(self, data: mujoco.MjData) -> CapturedFrame:
        count, taker = len(self._world.joints.names), self._taker
        nothing = np.full(count, np.nan)
        poses, faint = body_poses(data, taker.bodies, taker.copies, None)
        return CapturedFrame(
            poses=poses,
            opacity=np.concatenate([np.ones(len(taker.bodies)), faint]),
            grey=np.zeros(len(poses), bool),
            soft=SoftParts(self._world.model).take(data),
            values={"joint_angles": nothing, "torques": nothing},
            arrows=nothing,
            limit=self._world.joints.torque_limit,
            stale=np.zeros(count, bool),
            geoms=(np.zeros(0, GEOM), np.zeros(0, int), np.zeros(0, int)),
            labels={},
            note="",
            legend="",
            arrow_texts={},
        )

    def result(
        self,
        frames: Sequence[CapturedFrame],
        *,
        fps: float,
        begin: float = 0.0,
        marks: Sequence[Mark] = (),
        silent: Sequence[str] = (),
        toggles: Toggles | None = None,
        needed: float | None = None,
    ) -> CapturedRun:
        """Joins captured frames to a run with `toggles`, by default the declared switches."""
        world = self._world
        poses = np.array([each.poses for each in frames])
        opacity = np.array([each.opacity for each in frames])
        _hold_last(poses, poses[..., 2] < OUT_OF_SIGHT[2] / 2)
        values = {key: np.array([f.values[key] for f in frames]) for key in frames[0].values}
        if toggles is None:
            toggles = Toggles(world)
            toggles.modelled[:] = self.toggles.modelled
        lines, details = _lines(world, values, toggles)
        return CapturedRun(
            world=world,
            fps=fps,
            begin=begin,
            toggles=toggles,
            camera=self._camera,
            lines=lines,
            details=details,
            bodies=self._taker.bodies,
            positions=poses[..., :3],
            rotations=_continuous(poses[..., 3:]),
            opacity=opacity,
            grey=np.array([each.grey for each in frames]),
            values={key: each for key, each in values.items() if np.isfinite(each).any()},
            arrows=np.array([each.arrows for each in frames]),
            limit=frames[0].limit,
            stale=np.array([each.stale for each in frames], bool),
            soft=soft_of([each.soft for each in frames]),
            items=_items([each.geoms for each in frames]),
            labels=[each.labels for each in frames],
            notes=[each.note for each in frames],
            legend=[each.legend for each in frames],
            arrow_texts=_arrow_texts([each.arrow_texts for each in frames]),
            marks=marks,
            silent=list(silent),
            copies=self._taker.copies.each,
            needed=needed,
        )


def capture(
    scene: Scene,
    *,
    seconds: float | None = None,
    begin: float = 0.0,
    fps: float = DEFAULT_FPS,
    camera: str | None = None,
    follow: str | None = None,
    wait: float = 2.0,
    marks: Sequence[Mark] = (),
    on_progress: Callable[[int, int], None] | None = None,
) -> CapturedRun:
    """Captures a moving scene. Live sources run in real time, all others as fast as possible.

    Args:
        scene: scene to capture.
        seconds: maximum duration in seconds; None for the duration of the sources.
        begin: time of the first frame in seconds; 0 for live sources.
        fps: frames per second.
        camera: initial camera, see `find_camera`; None for the view that the scene declares.
        follow: name of the frame that the free camera follows; None for the scene's setting.
        wait: maximum time to wait for the first packet of each source in seconds.
        marks: marks on the timeline.
        on_progress: function called with the number of finished frames and the total number.

    Raises:
        SeroError: the scene, a source or the camera has a problem, or the run is too long.
    """
    with Mirror(scene) as mirror:
        world = mirror.world
        count = _frame_count(mirror, seconds, begin, fps)
        first = find_camera(world, camera)
        framing, capturer = Framing(world, first, camera), FrameCapturer(world, first)
        follower, path = None, list[Array]()
        if (name := followed(world, first, follow)) is not None:
            follower = Follower(world, name, declared_data(world))
        elif not mirror.is_live:
            framing.hold(first, known_poses(mirror, begin, begin + count / fps), DEFAULT_SIZE)
        data, frames = world.make_data(), list[CapturedFrame]()
        held = HeldTorques(mirror, capturer.toggles)
        silent = mirror.wait(wait)
        for state in sampled_states(mirror, count, fps, begin):
            restore(world, data, state)
            held.update(data)
            if follower is not None:
                path.append(follower.displacement(data))
            elif not frames:
                framing.fit(first, data)
            frames.append(capturer.take(data))
            if on_progress is not None:
                on_progress(len(frames), count)
    found = capturer.result(
        frames, fps=fps, begin=begin, marks=marks, silent=silent, needed=framing.needed
    )
    found.path = np.cumsum(path, axis=0) if path else None
    return found


def capture_pose(
    world: WorldView,
    data: mujoco.MjData,
    camera: mujoco.MjvCamera,
    needed: float | None = None,
) -> CapturedRun:
    """Captures the first pose for a live page, which gets values and overlays with each frame."""
    capturer = FrameCapturer(world, camera)
    return capturer.result([capturer.pose(data)], fps=DEFAULT_FPS, needed=needed)


def longest(world: World, fps: float) -> float:
    """Returns the maximum duration in seconds of a run that fits into a browser's memory."""
    of_frame = 28 * len(shown_bodies(world)) + 32 * len(world.joints.names) + 64
    return MAX_BYTES / (of_frame + bytes_of_frame(world.model)) / fps


def _frame_count(mirror: Mirror, seconds: float | None, begin: float, fps: float) -> int:
    ends = [source.end for source in mirror.sources.values() if source.end is not None]
    left = max(ends) - begin if ends else None
    if ends and max(ends) <= 0:
        names = ", ".join(mirror.sources)
        raise RenderError(f"{names}: found no valid packet; expected at least one")
    if left is not None and left <= 0:
        raise RenderError(f"found a start at {begin:g} s, but the sources end at {max(ends):g} s")
    if seconds is None:
        seconds = left or (DEFAULT_SECONDS if mirror.sources else 0.0)
    if seconds > (limit := longest(mirror.world, fps)):
        raise RenderError(
            f"found a length of {seconds:g} s; expected at most {limit:.0f} s of this scene at "
            f"{fps:g} frames per second: export a shorter part, or fewer frames per second"
        )
    if left is not None and not mirror.is_live:
        seconds = min(seconds, left)
    return int(np.floor(seconds * fps + 1e-9)) + 1


def _view(model: mujoco.MjModel, data: mujoco.MjData, camera: mujoco.MjvCamera) -> ImageView:
    scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 64)
    everything = int(mujoco.mjtCatBit.mjCAT_ALL)
    option, perturb = mujoco.MjvOption(), mujoco.MjvPerturb()
    mujoco.mjv_updateScene(model, data, option, perturb, camera, everything, scene)
    return ImageView.of_scene(scene, *_SIZE)


def _hold_last(poses: Array, far: Bools) -> None:
    """Replaces each missing pose of a body by the last known pose, or by the first known pose."""
    for b in np.flatnonzero(far.any(axis=0)):
        there = np.flatnonzero(~far[:, b])
        if not len(there):
            poses[:, b] = (0, 0, 0, 1, 0, 0, 0)
            continue
        last = np.searchsorted(there, np.arange(len(poses)), side="right") - 1
        poses[:, b] = poses[there[np.maximum(last, 0)], b]


def _continuous(rotations: Array) -> Array:
    """Changes the signs of quaternions so that they do not jump between frames."""
    signs = np.where((rotations[1:] * rotations[:-1]).sum(axis=-1) < 0, -1.0, 1.0)
    rotations[1:] *= np.cumprod(signs, axis=0)[..., None]
    return rotations


def _lines(
    world: WorldView, values: dict[str, Array], toggles: Toggles
) -> tuple[list[list[LineFormat]], list[list[LineFormat]]]:
    """Returns the billboard lines of each joint, and the lines with all values of each joint.

    If torques are available, a default billboard with only the angle or the torque shows the
    quantity of the arrow instead, which is the torque or the torque error.
    """
    are_errors = shows_errors(toggles)
    formats = joint_formats(world)
    declared = list(formats.declared)
    came = np.atleast_1d(np.isfinite(values["torques"]).any(axis=0))
    for part in world.owners.values():
        if came[part.joints].any() and not has_chosen_lines(part):
            for j in range(part.joints.start, part.joints.stop):
                if [line.key for line in declared[j]] in (["joint_angles"], ["torques"]):
                    declared[j] = (formats.errors if are_errors[j] else formats.torques)[j]
        for j in np.flatnonzero(toggles.modelled[part.joints]) + part.joints.start:
            declared[j] = formats.modelled[j]
    return declared, formats.details


def _items(rows: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> list[DecorItem]:
    found: dict[tuple[int, int, int, int], DecorItem] = {}
    for k, (geoms, kinds, items) in enumerate(rows):
        count: dict[tuple[int, int, int], int] = {}
        types = types_of(geoms).tolist()
        for row, kind, item, of in zip(geoms, kinds.tolist(), items.tolist(), types, strict=True):
            key = kind, item, of
            number = count[key] = count.get(key, -1) + 1
            place = found.get((*key, number))
            if place is None:
                place = DecorItem(
                    Kind(kind), item, np.zeros(len(rows), GEOM), np.zeros(len(rows), bool)
                )
                found[*key, number] = place
            place.rows[k], place.visible[k] = row, True
    return list(found.values())


def _arrow_texts(texts: list[dict[int, str]]) -> dict[int, list[str]]:
    items = sorted({item for each in texts for item in each})
    return {item: [each.get(item, "") for each in texts] for item in items}


def eye(capture: CapturedRun) -> dict[str, Any]:
    """Returns the initial camera of a page as a JSON object."""
    camera, world, needed = capture.camera, capture.world, capture.needed
    fixed = int(camera.fixedcamid) if camera.type == mujoco.mjtCamera.mjCAMERA_FIXED else -1
    return {
        "lookAt": np.round(camera.lookat, 5).tolist(),
        "distance": round(float(camera.distance), 5),
        "azimuth": round(float(camera.azimuth), 3),
        "elevation": round(float(camera.elevation), 3),
        "fovy": round(float(world.model.vis.global_.fovy), 3),
        "aspect": round(needed_aspect(world, camera) if needed is None else needed, 4),
        "fixed": fixed,
    }
