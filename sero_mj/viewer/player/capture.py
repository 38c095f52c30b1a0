"""Collects what a player shows of a scene: poses, values and decor of every frame, without OpenGL.

Bodies, joints and decor are those that windows draw. What depends on the camera, such as places of
cards, is left to the player.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import mujoco
import numpy as np

from ...base.errors import RenderError
from ...base.frames import Array, Bools, Ints
from ...data.drive.mirror import Mirror, restore
from ...robots.assemble.parts import DoublePart, DrawnDouble
from ...robots.assemble.world import World
from ...robots.assemble.world_view import WorldView
from ...robots.declared.double import OUT_OF_SIGHT
from ...robots.declared.scene import Scene
from ..decor.billboards import Line, has_chosen_lines, joint_formats, shows_errors
from ..decor.draw import Decor
from ..decor.feature import Frame
from ..decor.geom_buffer import GEOM, GeomBuffer, Kind
from ..decor.legend import SCALE, Legend
from ..decor.picture_view import PictureView
from ..decor.quantities import joint_name
from ..decor.toggles import Toggles
from ..image.camera import Follower, find_camera, followed
from ..image.framing import Framing, declared_data, needed_aspect
from ..image.held_torques import HeldTorques
from ..image.picture_options import DEFAULT_SIZE
from ..image.sampling import known_poses, sampled_states
from .copied_bodies import CopiedBodies, CopiedBody
from .labels import labels_of
from .model import drawn_bodies, visible_geoms
from .soft import Soft, SoftFrame, SoftParts, bytes_of_frame, soft_of

DEFAULT_FPS = 30.0
DEFAULT_SECONDS = 10.0  # of what has no end
MAX_BYTES = 128_000_000  # of a run in a browser's memory
_LABEL = int(mujoco.mjtGeom.mjGEOM_LABEL)
_ARROW_GEOMS = 24  # of round arrows at frames; those of joints are made by the player
_SIZE = (1280, 800)  # pixels; some decor asks for a picture


@dataclass(frozen=True)
class Mark:
    """Something on the time line.

    Attributes:
        begin: s since the start of the page.
        end: s; the same for a moment.
        text: what.
        kind: `push` and `fault` were done, `finding` was found by a monitor, `bookmark` was set by
            a user, an expectation has `held` or `failed`.
    """

    begin: float
    end: float
    text: str
    kind: Literal["push", "fault", "finding", "bookmark", "held", "failed"]


@dataclass(frozen=True, eq=False)
class Item:
    """A geom of decor through all frames.

    Attributes:
        kind: of what it shows.
        item: index of that, see `Kind`.
        rows: the geom in every frame, (F,) of `GEOM`.
        visible: whether it is drawn, (F,) bool.
    """

    kind: Kind
    item: int
    rows: np.ndarray
    visible: np.ndarray


@dataclass(eq=False)
class Capture:
    """What a player shows of a scene, F frames long.

    Attributes:
        world: the compiled scene.
        fps: frames per second.
        begin: time of the first frame, s.
        toggles: what is shown at first.
        camera: of the first picture.
        lines: of the card of every joint, (N,).
        details: lines of the values of every joint, (N,).
        bodies: ids of the bodies that carry something visible, (B,).
        positions: of the bodies, (F, B, 3), m.
        rotations: of the bodies, unit quaternions (F, B, 4).
        opacity: of the bodies, 0 where they are out of sight, (F, B).
        grey: whether bodies are drawn grey, because their data are stale, (F, B) bool.
        values: of the joints by name, (F, N); NaN for no data.
        arrows: what the round arrows show, (F, N).
        limit: value of an arrow of full width, (N,); inf for none.
        stale: joints without fresh data, (F, N) bool.
        soft: tendons and flexes.
        items: decor besides arrows of joints, and text.
        labels: text at places, see `labels_of`.
        notes: text in the corners, by frame, without the legend.
        legend: what arrows mean, by frame: of those that are seen there, if they are switched on.
        cards: of the smart arrows: index to text by frame, empty where there is none.
        marks: on the time line.
        silent: names of the sources without data.
        meanings: of labels on cards, by label: the file that `A` is, say.
        copies: G more bodies, of doubles; poses, opacity and greyness have them after the B.
        needed: width over height of a picture that the camera needs, see `needed_aspect`; that of
            the declared pose when None.
        path: by how far the free camera has moved with what it follows, (F, 3), m; None where it
            follows nothing.
    """

    world: WorldView
    fps: float
    begin: float
    toggles: Toggles
    camera: mujoco.MjvCamera
    lines: list[list[Line]]
    details: list[list[Line]]
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
    items: list[Item]
    labels: list[Any]
    notes: list[str]
    legend: list[str]
    cards: dict[int, list[str]]
    marks: Sequence[Mark] = ()
    silent: list[str] = field(default_factory=list)
    meanings: Mapping[str, str] = field(default_factory=dict)
    copies: Sequence[CopiedBody] = ()
    needed: float | None = None
    path: Array | None = None

    @property
    def frames(self) -> int:
        """How many frames there are."""
        return len(self.positions)

    @property
    def joint_names(self) -> list[str]:
        """Name of every joint with its robot, `lwr/A4`, (N,)."""
        return [joint_name(self.world, i) for i in range(len(self.world.joints.names))]

    @property
    def geoms(self) -> Ints:
        """Ids of the geoms of the model that are drawn, without our floor."""
        return visible_geoms(self.world.model)


class CapturedFrame(NamedTuple):
    """What a player shows of one state; arrays as of `Capture`, without the axis of frames.

    Attributes:
        poses: of the bodies, place and unit quaternion, (B + G, 7).
        opacity: of the bodies, (B + G,).
        soft: tendons and flexes.
        values: of the joints by name, (N,) each.
        arrows: what the round arrows show, (N,).
        limit: value of an arrow of full width, (N,).
        stale: joints without fresh data, (N,) bool.
        geoms: of decor: rows, kinds and items, see `player_geoms`.
        labels: see `labels_of`.
        note: text in the corners, without the legend.
        legend: what arrows mean.
        cards: text of the smart arrows, by their index.
    """

    poses: Array
    opacity: Array
    soft: SoftFrame
    values: dict[str, Array]
    arrows: Array
    limit: Array
    stale: Bools
    geoms: tuple[np.ndarray, np.ndarray, np.ndarray]
    labels: dict[Any, Any]
    note: str
    legend: str
    cards: dict[int, str]


class FrameCapturer:
    """Captures states of a world one by one.

    It is the last feature of a decor of its own, and takes what all others have made; the player
    itself draws the arrows of joints.

    Args:
        world: the compiled scene.
        camera: of the first picture.

    Attributes:
        toggles: of what is captured.
    """

    def __init__(self, world: WorldView, camera: mujoco.MjvCamera) -> None:
        self._world, self._camera = world, camera
        self.toggles = Toggles(world)
        self.toggles.billboards[:] = False
        self.toggles.doubles[:] = self.toggles.cards[:] = True
        self._decor = Decor(world, arrow_geoms=_ARROW_GEOMS)
        for feature in self._decor.features:
            if isinstance(feature, Legend):
                feature.is_steady = False
        self._decor.features.append(self)
        self._view: PictureView | None = None
        self._bodies, self._copies = shown_bodies(world), CopiedBodies(world)
        self._soft = SoftParts(world.model)
        self._note, self._legend, self._cards = "", "", dict[int, str]()
        self._frame: Frame | None = None

    def lay_out(self, frame: Frame) -> None:
        """Takes texts; places of panels are left to the player."""
        self._note, self._legend = (
            "\n\n".join(
                "\n".join(map(line_text, lines))
                for group in frame.corners
                if group.of_arrows == of_arrows
                for lines in group.texts
            )
            for of_arrows in (False, True)
        )
        self._cards = {
            int(item): "\n".join(map(line_text, lines))
            for group in frame.cards
            if group.kind == Kind.CARD
            for item, lines in zip(group.items, group.texts, strict=True)
        }
        for groups in (frame.corners, frame.cards, frame.panels):
            groups.clear()

    def draw(self, frame: Frame) -> None:
        """Takes the frame, with all geoms."""
        self._frame = frame

    def take(self, data: mujoco.MjData) -> CapturedFrame:
        """Captures a state, with everything up to date that is drawn of it."""
        world, bodies = self._world, self._bodies
        if self._view is None:
            self._view = _view(world.model, data, self._camera)
        buffer = self._decor.draw(data, self.toggles, self._view)
        frame = self._frame
        assert frame is not None  # `draw` has just been called
        places, turns, faint = body_poses(data, bodies, self._copies, buffer.drawn_doubles)
        return CapturedFrame(
            poses=np.hstack([places, turns]),
            opacity=np.concatenate([body_opacity(world.model, buffer)[bodies], faint]),
            soft=self._soft.take(data),
            values=frame.values,
            arrows=frame.arrow_values,
            limit=frame.arrow_limit,
            stale=frame.stale_joints,
            geoms=player_geoms(frame.buffer, np.ones(len(world.joints.names), bool)),
            labels=labels_of(world, frame),
            note=self._note,
            legend=self._legend,
            cards=self._cards,
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
    ) -> Capture:
        """Returns frames as one; at least one.

        Args:
            frames: of this world, in their order.
            fps: of them.
            begin: time of the first one, s.
            marks: on the time line.
            silent: names of the sources without data.
            toggles: what is shown at first; as declared when None.
            needed: see `Capture`.
        """
        world, bodies = self._world, self._bodies
        poses = np.array([each.poses for each in frames])
        opacity = np.array([each.opacity for each in frames])
        _hide_far_away(poses, opacity)
        values = {key: np.array([f.values[key] for f in frames]) for key in frames[0].values}
        if toggles is None:
            toggles = Toggles(world)
            toggles.modelled[:] = self.toggles.modelled
        lines, details = _lines(world, values, toggles)
        stale = np.array([each.stale for each in frames], bool)
        grey = np.zeros(opacity.shape, bool)
        of_body = grey[:, : len(bodies)]
        for part in world.owners.values():
            if part.joints.stop > part.joints.start and not isinstance(part, DoublePart):
                is_stale = np.all(stale[:, part.joints], axis=1)
                of_body[:, np.isin(bodies, part.bodies)] = np.asarray(is_stale)[:, None]
        return Capture(
            world=world,
            fps=fps,
            begin=begin,
            toggles=toggles,
            camera=self._camera,
            lines=lines,
            details=details,
            bodies=bodies,
            positions=poses[..., :3],
            rotations=_continuous(poses[..., 3:]),
            opacity=opacity,
            grey=grey,
            values={key: each for key, each in values.items() if np.isfinite(each).any()},
            arrows=np.array([each.arrows for each in frames]),
            limit=frames[0].limit,
            stale=stale,
            soft=soft_of([each.soft for each in frames]),
            items=_items([each.geoms for each in frames]),
            labels=[each.labels for each in frames],
            notes=[each.note for each in frames],
            legend=[each.legend for each in frames],
            cards=_cards([each.cards for each in frames]),
            marks=marks,
            silent=list(silent),
            copies=self._copies.each,
            needed=needed,
        )


def player_geoms(buffer: GeomBuffer, own: Bools) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns what a player draws geom by geom: all but text and the arrows that it makes itself.

    Args:
        buffer: of a frame.
        own: joints whose arrows it makes from their values, (N,).

    Returns:
        rows (k,) of `GEOM`, and kind and item of each, (k,).
    """
    kinds, items = buffer.kinds[: buffer.count], buffer.items[: buffer.count]
    is_arrow = kinds == Kind.ARROW
    kept = ~is_arrow
    kept[is_arrow] = ~own[items[is_arrow]]
    # Panels stand in front of the camera, and are laid out by the player.
    kept[buffer.text] = False
    kept &= buffer.rows["type"][: buffer.count] != _LABEL
    index = kept.nonzero()[0]
    return buffer.rows[index], kinds[index], items[index]


def body_poses(
    data: mujoco.MjData, bodies: Ints, copies: CopiedBodies, drawn: Sequence[DrawnDouble]
) -> tuple[Array, Array, Array]:
    """Returns the poses of bodies, and after them of their copies.

    Args:
        data: the state, with frames up to date.
        bodies: ids, (B,).
        copies: of doubles, G of them.
        drawn: the doubles of the frame.

    Returns:
        positions (B + G, 3), m, unit quaternions (B + G, 4), and the opacity of the copies, (G,).
    """
    places, turns, opacity = copies.poses(drawn)
    return (
        np.concatenate([data.xpos[bodies], places]),
        np.concatenate([data.xquat[bodies], turns]),
        opacity,
    )


def body_opacity(model: mujoco.MjModel, buffer: GeomBuffer) -> Array:
    """Returns by how much every body is faded in a frame, (nbody,): 0 where it is not drawn."""
    found = np.ones(model.nbody)
    if buffer.opacity is not None:
        np.minimum.at(found, model.geom_bodyid, buffer.opacity)
    if buffer.hidden is not None:
        found[model.geom_bodyid[buffer.hidden]] = 0.0
    return found


def line_text(line: bytes) -> str:
    """A line as text; the legend's scale has bars, of which only the last one has a name."""
    text = line.decode("latin-1").rstrip()
    scale = "".join(SCALE)
    return f"full width: {text.removeprefix(scale)}" if text.startswith(scale) else text


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
) -> Capture:
    """Collects a scene as it moves; live sources in real time, others as fast as it goes.

    Args:
        scene: what to show.
        seconds: how long, at most to the end of its sources; to there when None.
        begin: time of the first frame, s; 0 for live sources.
        fps: frames per second.
        camera: see `find_camera`.
        follow: what the free camera moves with, see `Follower`; what the view does when None.
        wait: how long to wait for the first packet of every source, s.
        marks: on the time line.
        on_progress: called with the number of frames until now, and of all frames.

    Raises:
        SeroError: a problem of the scene, its sources or the camera; or it is too long for a page.
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
) -> Capture:
    """Collects one pose without decor and values, which a live page is sent for every picture.

    Args:
        world: the compiled scene.
        data: its state, with frames up to date.
        camera: of the first picture.
        needed: see `Capture`.
    """
    joints, bodies, copies = world.joints, shown_bodies(world), CopiedBodies(world)
    places, turns, faint = body_poses(data, bodies, copies, [])
    formats = joint_formats(world)
    count = len(joints.names)
    nothing = np.full((1, count), np.nan)
    return Capture(
        world=world,
        fps=DEFAULT_FPS,
        begin=0.0,
        toggles=Toggles(world),
        camera=camera,
        lines=formats.declared,
        details=formats.details,
        bodies=bodies,
        positions=places[None],
        rotations=turns[None],
        opacity=np.concatenate([np.ones(len(bodies)), faint])[None],
        grey=np.zeros((1, len(places)), bool),
        values={"joint_angles": nothing},
        arrows=nothing,
        limit=joints.torque_limit,
        stale=np.zeros((1, count), bool),
        soft=soft_of([SoftParts(world.model).take(data)]),
        items=[],
        labels=[{}],
        notes=[""],
        legend=[""],
        cards={},
        copies=copies.each,
        needed=needed,
    )


def longest(world: World, fps: float) -> float:
    """Returns how long a page of a world may be, s."""
    of_frame = 28 * len(shown_bodies(world)) + 32 * len(world.joints.names) + 64
    return MAX_BYTES / (of_frame + bytes_of_frame(world.model)) / fps


def _frame_count(mirror: Mirror, seconds: float | None, begin: float, fps: float) -> int:
    """How many frames there are; raises RenderError where they are too many."""
    ends = [source.end for source in mirror.sources.values() if source.end is not None]
    left = max(ends) - begin if ends else None
    if ends and max(ends) <= 0:
        names = ", ".join(mirror.sources)
        raise RenderError(f"{names}: found no good packet; expected at least one")
    if left is not None and left <= 0:
        raise RenderError(f"found a begin at {begin:g} s; it ends at {max(ends):g} s")
    if seconds is None:
        seconds = left or (DEFAULT_SECONDS if mirror.sources else 0.0)
    if seconds > (most := longest(mirror.world, fps)):
        raise RenderError(
            f"found {seconds:g} s; expected at most {most:.0f} s of this scene at {fps:g} frames "
            "per second: export a part of it, or fewer frames per second"
        )
    if left is not None and not mirror.is_live:
        seconds = min(seconds, left)
    return int(np.floor(seconds * fps + 1e-9)) + 1


def _view(model: mujoco.MjModel, data: mujoco.MjData, camera: mujoco.MjvCamera) -> PictureView:
    """Returns a view of a state, for decor that depends on a picture's."""
    scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 64)
    everything = int(mujoco.mjtCatBit.mjCAT_ALL)
    option, perturb = mujoco.MjvOption(), mujoco.MjvPerturb()
    mujoco.mjv_updateScene(model, data, option, perturb, camera, everything, scene)
    return PictureView.of_scene(scene, *_SIZE)


def shown_bodies(world: WorldView) -> Ints:
    """Returns ids of the bodies that something is drawn at, (B,)."""
    model = world.model
    own = [drawn_bodies(model), model.cam_bodyid]
    if world.has_sites:
        own.append(model.site_bodyid[world.joints.centre_site])
    return np.unique(np.concatenate(own)).astype(np.intp)


def _hide_far_away(poses: Array, opacity: Array) -> None:
    """Hides bodies without a pose, which stay at their last or next one instead of far away."""
    far = np.asarray(poses[..., 2] < OUT_OF_SIGHT[2] / 2)
    opacity[far] = 0.0
    for b in np.flatnonzero(far.any(axis=0)):
        there = np.flatnonzero(~far[:, b])
        if not len(there):
            poses[:, b] = (0, 0, 0, 1, 0, 0, 0)
            continue
        last = np.searchsorted(there, np.arange(len(poses)), side="right") - 1
        poses[:, b] = poses[there[np.maximum(last, 0)], b]


def _continuous(rotations: Array) -> Array:
    """Quaternions with signs such that none jumps from frame to frame."""
    signs = np.where((rotations[1:] * rotations[:-1]).sum(axis=-1) < 0, -1.0, 1.0)
    rotations[1:] *= np.cumprod(signs, axis=0)[..., None]
    return rotations


def _lines(
    world: WorldView, values: dict[str, Array], toggles: Toggles
) -> tuple[list[list[Line]], list[list[Line]]]:
    """The lines of the cards of all joints, and those of what arrows show.

    Angles give way to torques where there are some, and these to what arrows show.
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


def _items(rows: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> list[Item]:
    """Sorts the geoms of all frames by what they show, so that each has a place of its own."""
    found: dict[tuple[int, int, int, int], Item] = {}
    for k, (geoms, kinds, items) in enumerate(rows):
        count: dict[tuple[int, int, int], int] = {}
        for row, kind, item in zip(geoms, kinds.tolist(), items.tolist(), strict=True):
            key = (kind, item, int(row["type"]))
            number = count[key] = count.get(key, -1) + 1
            place = found.get((*key, number))
            if place is None:
                place = Item(Kind(kind), item, np.zeros(len(rows), GEOM), np.zeros(len(rows), bool))
                found[*key, number] = place
            place.rows[k], place.visible[k] = row, True
    return list(found.values())


def _cards(cards: list[dict[int, str]]) -> dict[int, list[str]]:
    items = sorted({item for each in cards for item in each})
    return {item: [each.get(item, "") for each in cards] for item in items}


def eye(capture: Capture) -> dict[str, Any]:
    """Returns the first camera of a page, as JSON."""
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
