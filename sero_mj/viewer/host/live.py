"""`LiveHost`: the common base of window and web page."""

from __future__ import annotations

import logging
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar, Self

import mujoco

from ...base.errors import SeroError
from ...base.paths import without_temporary
from ...data.drive.mirror import LiveWorld
from ..decor.quantities import joint_name
from ..decor.toggles import Toggles
from ..image.camera import Navigator
from ..image.clicks import KEYS, press_toggle
from ..image.image_files import Pixels
from ..image.image_options import DEFAULT_SIZE
from ..image.sampling import recorded_poses
from ..image.scene_decor import SceneDecor
from ..panels.robot_panel import RobotPanel
from ..panels.status_line import SourcesPanel
from ..session.camera_control import CameraControl
from ..session.clock import Clock
from ..session.status_line import Message
from ..session.tool import Action, Actions, DrawnTool, Tools
from ..session.view_state import ViewState, view_state_of
from ..session.widgets import Widgets
from .other_scenes import OtherScenes
from .pointer import Pointer

log = logging.getLogger(__name__)

_JUMP = 1.0  # time step of the keys for back and forward, s
HIDDEN_INTERVAL = 0.1  # time between frames of a page that no browser shows, s
SECTION = "section "  # prefix of section names in a layout
_MESSAGE_TIME, _ERROR_TIME = 3.0, 9.0  # display times, s


class LiveHost(ABC):
    """Base class of the window and the web page that show a scene and handle user input.

    Args:
        folder: directory for exported files, images and videos; None for the current directory.

    Attributes:
        joint: index of the selected joint in the world.
        command: command-line arguments with the scene and its options; None for only the scene.
        notice: last message to the user.
        folds: mapping from titles of collapsible panel sections to whether they are open.
        work: computing time of the last frame in seconds, without rendering.
    """

    decor: SceneDecor
    is_window: ClassVar[bool] = False

    def __init__(
        self, mirror: LiveWorld, folder: Path | None = None, camera: str | None = None
    ) -> None:
        world = mirror.world
        self.navigator = Navigator(world, camera)
        # This moves recordings in time, so it must come before plots listen to packets.
        self.navigator.hold(recorded_poses(mirror), DEFAULT_SIZE)
        self.mirror, self.world, self.data = mirror, world, mirror.data
        self.toggles = Toggles(world)
        self.clock = clock = Clock(mirror)
        if clock.is_live:
            clock.on_state = self._watch
        self.folder = folder
        self.joint = 0
        self.command: Sequence[str] | None = None
        self.notice = Message()
        self.folds: dict[str, bool] = {}
        self.shows_status, self.shows_help, self.shows_panel = True, False, False
        self.work = 0.0
        self._advanced = time.monotonic()
        self._sources = SourcesPanel()
        self._robots = RobotPanel(world, self.toggles)
        self._robots.on_select = self.select
        self.tools: Tools = Tools(self)
        self.camera_control = CameraControl(self.navigator, self.data, lambda: self.decor, self.say)
        self.pointer = Pointer(self)
        self.others = OtherScenes(self.say, self.request_close)
        own: dict[str, Action] = {
            "pause": clock.pause,
            "step": clock.step,
            "step_back": lambda: clock.step(-1),
            "slower": lambda: clock.faster(-1),
            "faster": lambda: clock.faster(1),
            "reset": clock.reset,
            "back": lambda: clock.seek(clock.time - _JUMP),
            "on": lambda: clock.seek(clock.time + _JUMP),
            "end": clock.go_live,
            "next_joint": lambda: self._select(1),
            "last_joint": lambda: self._select(-1),
            "follow": self.pointer.follow,
            "help": partial(self.toggle, "shows_help"),
            "status_line": partial(self.toggle, "shows_status"),
            "panel": partial(self.toggle, "shows_panel"),
            **{
                f"camera_{number}": partial(self.camera_control.choose, number)
                for number in range(10)
            },
            **{f"switch_{key}": partial(self._switch, key) for key in KEYS},
        }
        self.actions = Actions(own, self.tools, self.say)

    @property
    @abstractmethod
    def is_open(self) -> bool: ...

    @property
    def is_seen(self) -> bool:
        return True

    @property
    @abstractmethod
    def is_due(self) -> bool: ...

    @abstractmethod
    def frame(self, *, wait: bool = True) -> bool:
        """Shows one frame, and returns whether the window or page is still open."""

    @property
    @abstractmethod
    def image_size(self) -> tuple[int, int]: ...

    @abstractmethod
    def image(self) -> Pixels:
        """Returns the current image without panels: uint8 array, shape (height, width, 3)."""

    @property
    def view_camera(self) -> mujoco.MjvCamera:
        return self.navigator.camera

    @property
    def is_following(self) -> bool:
        return self.navigator.following is not None

    @abstractmethod
    def to_clipboard(self, text: str) -> None: ...

    @abstractmethod
    def request_close(self) -> None: ...

    def close(self) -> None:
        self.tools.call_all(lambda tool: tool.close())

    # ---- frames

    def run(self) -> None:
        while self.frame():
            pass

    def _use(self, decor: SceneDecor) -> None:
        for tool in self.tools.values():
            decor.add(DrawnTool(tool, self.tools))

    def _advance(self, passed: float) -> None:
        """Advances the clock by `passed` seconds of real time, and updates the tools."""
        now = time.monotonic()
        since, self._advanced = now - self._advanced, now
        self.pointer.dragging.advance()
        self.tools.call_all(lambda tool: tool.advance(since))
        if not self.clock.is_live:
            needs_all = any(self.tools.call_all(lambda tool: tool.needs_every_state))
            self.clock.on_state = self._watch if needs_all else None
        try:
            self.clock.advance(passed)
        except SeroError as error:  # If a file was deleted, the last state remains visible.
            self.clock.is_paused = True
            self.say(str(error), is_bad=True)
        if not (self.clock.is_live or self.clock.is_paused):
            self._watch()
        found = self.tools.first(lambda tool: tool.next_message())
        if found is not None:
            self.say(*found[1])

    def _watch(self) -> None:
        self.tools.call_all(lambda tool: tool.watch())

    # ---- messages, panel and keys

    def say(self, text: str, is_bad: bool = False) -> None:
        """Shows a message for a few seconds. An empty string removes the current message."""
        seconds = (_ERROR_TIME if is_bad else _MESSAGE_TIME) if text else 0.0
        self.notice = Message(without_temporary(text), is_bad, time.monotonic() + seconds)

    def toggle(self, part: str) -> None:
        """Inverts one of the attributes `shows_help`, `shows_status` and `shows_panel`."""
        setattr(self, part, not getattr(self, part))

    @property
    def has_timeline(self) -> bool:
        return self.clock.is_playing and self.clock.can_go_back

    def build_panel(self, ui: Widgets, *, unfolds_sources: bool) -> None:
        sources = self.mirror.sources.values()
        self._sources.build(ui, self.clock, sources, is_open=unfolds_sources)
        self.others.build(ui)
        self.tools.call_all(lambda tool: tool.build(ui))
        self._robots.build(ui)

    def _switch(self, key: str) -> str:
        return press_toggle(key, self.world, self.data, self.toggles)

    def _select(self, places: int) -> str:
        names = self.world.joints.names
        if not names:
            return "this scene has no joints"
        self.select((self.joint + places) % len(names))
        return f"selected: {joint_name(self.world, self.joint)}"

    def select(self, joint: int) -> None:
        self.joint = self.toggles.selected = joint

    # ---- the saved view

    @property
    def layout(self) -> dict[str, bool]:
        """Mapping from names of panels, areas and sections to whether they are visible or open."""
        areas = {name: tool.shows_area for name, tool in self.tools.items() if tool.area}
        sections = {f"{SECTION}{name}": is_open for name, is_open in self.folds.items()}
        return {"status": self.shows_status, "panel": self.shows_panel, **areas, **sections}

    def show_layout(self, layout: Mapping[str, bool]) -> None:
        self.shows_status = layout.get("status", self.shows_status)
        self.shows_panel = layout.get("panel", self.shows_panel)
        for name, tool in self.tools.items():
            tool.shows_area = layout.get(name, tool.shows_area)
        for name, is_open in layout.items():
            if name.startswith(SECTION):
                self.folds[name.removeprefix(SECTION)] = is_open

    def view_state(self) -> ViewState:
        return view_state_of(self.world, self.view_camera, self.toggles, self.clock)

    def render_words(self) -> list[str]:
        """Returns the arguments with which `sero-mj render` reproduces the current view."""
        words = [*(self.command or [self.world.scene.argument])]
        state = self.view_state()
        for of_tool in self.tools.call_all(lambda tool: tool.render_words()):
            words += of_tool
        # If a background photo fixes the camera, no option can reproduce the camera.
        if not self.decor.fixed:
            words += ["--camera", state.camera]
        for name, digits in state.switches.items():
            words += ["--show", f"{name}={digits}"]
        words += ["--select", state.joint] * bool(state.joint)
        return words

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
