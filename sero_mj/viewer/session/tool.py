"""`Tool`: base class of tools, with which users act on the displayed world.

A tool can have keys, a section in the panel, and actions of the pointer. Each tool is one file with
an entry point. A package adds a tool in pyproject.toml:

    [project.entry-points."sero_mj.tools"]
    measure = "my_package:Measure"
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol, TypeVar

import mujoco

from ...base.errors import SeroError
from ...base.frames import Array
from ...base.plugins import TOOLS, accept_old_names, is_own_class, load_all
from ...data.drive.mirror import LiveWorld
from ...robots.assemble.world_view import WorldView
from ..decor.feature import Frame
from ..decor.toggles import Toggles
from ..image.clicks import KEYS
from ..image.image_files import Pixels
from ..image.picking import Picked, Pixel
from ..image.scene_decor import SceneDecor
from .camera_control import CameraControl
from .clock import Clock, Tick
from .joint_goal import JointGoal
from .keys import MORE_KEYS, VIEWER_KEYS, Key, Row
from .status_line import Piece
from .view_state import ViewState
from .widgets import Widgets

log = logging.getLogger(__name__)

Action = Callable[[], str | None]  # function that returns a message for the user, or None
Found = TypeVar("Found")

# Old names of methods are supported for one version.
_RENAMED = {
    "hear": "receive",
    "answer": "reply",
    "kept": "saved_state",
    "take_kept": "restore_saved",
    "takes_pictures": "takes_images",
    "wants_picture": "wants_image",
    "take_picture": "take_image",
    "watches_closely": "needs_every_state",
}


class Shown(Protocol):
    """The interface of windows and pages for tools.

    Attributes:
        data: displayed state. Frames are up to date when `draw` and methods for the pointer are
            called.
        clock: clock with pause, speed and timeline.
        decor: decor of the last frame, which finds items at pixels and has the camera's view.
        folder: directory for saved files; None for the current directory.
        joint: index of the selected joint in the world.
        is_window: True for a window, False for a page.
    """

    mirror: LiveWorld
    world: WorldView
    data: mujoco.MjData
    toggles: Toggles
    clock: Clock
    decor: SceneDecor
    folder: Path | None
    joint: int
    tools: Tools
    actions: Actions
    camera_control: CameraControl
    shows_panel: bool
    is_window: ClassVar[bool]

    @property
    def view_camera(self) -> mujoco.MjvCamera: ...
    @property
    def is_following(self) -> bool: ...
    @property
    def image_size(self) -> tuple[int, int]: ...

    def say(self, text: str, is_bad: bool = False) -> None: ...

    def select(self, joint: int) -> None: ...

    def view_state(self) -> ViewState: ...

    def render_words(self) -> list[str]: ...

    def to_clipboard(self, text: str) -> None: ...


class Grab(NamedTuple):
    """Answer of a tool to the start of a drag.

    Attributes:
        text: message for the user.
        is_refused: whether nothing can be dragged. If so, `text` explains why.
    """

    text: str
    is_refused: bool = False


class PointerEvents:
    """Methods for the pointer events of a tool. The pixel (0, 0) is the lower left corner."""

    def click(self, picked: Picked | None, at: Pixel) -> str | None:
        """Called when the user clicks. Returns a message, or None to pass the click on."""
        return None

    def hover(self, at: Pixel | None) -> bool:
        """Called in every frame. Returns whether a drag from this pixel would grab a handle.

        Args:
            at: pixel of the pointer; None outside the image or during a drag.
        """
        return False

    def grab_handle(self, at: Pixel) -> Grab | None:
        """Starts to drag a handle. Returns None if this tool has no handle at the pixel."""
        return None

    def grab(self, at: Pixel) -> Grab | None:
        """Starts a drag with Ctrl. Returns None if this tool drags nothing at the pixel."""
        return None

    def announce(self, at: Pixel) -> Grab | None:
        """Returns the result that `grab` would have at the pixel, without starting a drag."""
        return None

    def move(self, at: Pixel) -> None:
        """Called when the pointer moves during a drag."""

    def drag(self) -> str:
        """Called in every frame during a drag. Returns an error message or an empty string."""
        return ""

    def release(self) -> None:
        """Called when the drag ends."""

    def wheel(self, notches: float) -> str | None:
        """Called for the wheel during a drag. Returns a message, or None to zoom the camera."""
        return None


class ToolState:
    """Methods that save and restore the state of a tool."""

    @property
    def state(self) -> Any:
        """State that undo restores. States are compared with `==`."""
        return ()

    def restore(self, state: Any) -> None:
        """Restores an earlier value of the property `state`."""

    @property
    def saved_state(self) -> Any:
        """JSON data that the next start of the scene restores, or None."""
        return None

    def restore_saved(self, state: Any) -> None:
        """Restores a `saved_state`. Raises TypeError, ValueError or LookupError to reject it."""

    def render_words(self) -> list[str]:
        """Returns the arguments of `sero-mj render` that reproduce the tool's changes."""
        return []


class Tool(PointerEvents, ToolState):
    """Base class of tools. Override the methods of the events that the tool handles.

    Attributes:
        shown: window or page of the tool.
        order: number that determines the position in the panel from top to bottom, and the priority
            for drags and keys. Tools of sero-mj have numbers from 5 to 90.
        keys: mapping from keys to actions. A value is a `Key`, or the name of an action and a help
            text.
        area: title of the tool's area beside the image, or an empty string for no area.
        shows_area: whether the area is visible.
    """

    order: ClassVar[int] = 100
    keys: ClassVar[Mapping[str, Key | tuple[str, str]]] = {}
    area: str = ""
    shows_area: bool = False

    def __init__(self, shown: Shown) -> None:
        self.shown = shown

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        accept_old_names(cls, _RENAMED)

    def actions(self) -> Mapping[str, Action]:
        """Returns a mapping from names of actions, as in `keys`, to functions."""
        return {}

    @property
    def active(self) -> Collection[str]:
        """Names of the actions that are currently on. Menus mark these actions."""
        return ()

    def help_rows(self) -> Sequence[Row]:
        """Returns rows of the help, each with a key or gesture and its effect, or a heading."""
        return ()

    # ---- frames

    def advance(self, passed: float) -> None:
        """Called before the world advances, `passed` seconds after the last frame."""

    def watch(self) -> None:
        """Called for each new displayed state of live sources, recordings or simulations."""

    @property
    def needs_every_state(self) -> bool:
        """Whether `watch` also needs the states of recordings and simulations between frames."""
        return False

    def lay_out(self, frame: Frame) -> None:
        """Adds text panels to a frame, see `decor.feature.Feature`."""

    def draw(self, frame: Frame) -> None:
        """Adds geoms to a frame, see `decor.feature.Feature`."""

    def build(self, ui: Widgets) -> None:
        """Called in every frame. Builds the section of this tool in the side panel."""

    def build_area(self, ui: Widgets) -> None:
        """Called in every frame. Builds the area of this tool if `shows_area` is set."""

    def ongoing(self) -> Piece | None:
        """Returns text shown over the image, for example during a video recording, or None."""
        return None

    def ticks(self) -> Sequence[Tick]:
        """Returns the events that this tool shows on the timeline."""
        return ()

    def next_message(self) -> tuple[str, bool] | None:
        """Returns a message about background work and whether it is an error, or None."""
        return None

    # ---- messages from and to the program that has called `sero_mj.view`

    def receive(self, message: Any) -> None:
        """Called with each message from the program."""

    def reply(self) -> Any:
        """Called after every frame. Returns a message to the program, or None."""
        return None

    # ---- images

    @property
    def takes_images(self) -> bool:
        """Whether `take_image` needs frames in full quality and without panels."""
        return False

    def wants_image(self, now: float) -> bool:
        """Returns whether `take_image` needs this frame. `now` is the time of `time.monotonic`."""
        return False

    def take_image(self, pixels: Pixels, now: float) -> None:
        """Called with the image of a frame, shape (height, width, 3), and its time in seconds."""

    def goal(self) -> tuple[str, JointGoal, Array] | None:
        """Returns the robot that a gamepad can move: name, goal and T_world_base, shape (4, 4)."""
        return None

    def close(self) -> None:
        """Called when the window or page closes. Releases resources."""


class Tools(Mapping[str, Tool]):
    """Mapping from names to all tools of a window or page, sorted by `order`.

    If a tool of another package fails, the error is logged and shown, and the tool is removed.
    """

    def __init__(self, shown: Shown) -> None:
        self._shown = shown
        self._tools: dict[str, Tool] = {}
        for name, kind in tool_kinds().items():
            with self._guarding(name, kind):
                self._tools[name] = kind(shown)

    def __getitem__(self, name: str) -> Tool:
        return self._tools[name]

    def __iter__(self) -> Iterator[str]:
        return iter([*self._tools])

    def __len__(self) -> int:
        return len(self._tools)

    @contextmanager
    def _guarding(self, name: str, kind: type[Tool]) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            if is_own_class(kind) or isinstance(error, SeroError):
                raise
            log.exception("the tool %s has failed and is removed", name)
            self._tools.pop(name, None)
            self._shown.say(f"the tool {name} has failed and is removed: {error}", is_bad=True)

    def call(self, tool: Tool, act: Callable[[Tool], Found]) -> Found | None:
        """Returns the result of `act` for a tool, or None if the tool fails and is removed."""
        name = next((name for name, each in self._tools.items() if each is tool), "tool")
        result: Found | None = None
        with self._guarding(name, type(tool)):
            result = act(tool)
        return result

    def call_all(self, act: Callable[[Tool], Found]) -> list[Found]:
        """Returns the results of `act` for all tools, in their order."""
        results: list[Found] = []
        for name, tool in [*self._tools.items()]:
            with self._guarding(name, type(tool)):
                results.append(act(tool))
        return results

    def first(self, act: Callable[[Tool], Found | None]) -> tuple[Tool, Found] | None:
        """Returns the first tool for which `act` does not return None, and the result, or None."""
        for name, tool in [*self._tools.items()]:
            with self._guarding(name, type(tool)):
                result = act(tool)
                if result is not None:
                    return tool, result
        return None

    @property
    def areas(self) -> list[Tool]:
        """The tools whose areas are shown."""
        return [tool for tool in self.values() if tool.area and tool.shows_area]

    @property
    def ticks(self) -> list[Tick]:
        return [tick for ticks in self.call_all(lambda tool: tool.ticks()) for tick in ticks]

    @property
    def ongoing(self) -> Piece | None:
        found = self.first(lambda tool: tool.ongoing())
        return None if found is None else found[1]

    @property
    def takes_images(self) -> bool:
        return any(self.call_all(lambda tool: tool.takes_images))

    def distribute_image(self, draw: Callable[[], Pixels]) -> None:
        """Renders the current image if any tool needs it, and passes it to these tools."""
        now = time.monotonic()
        wanting = self.call_all(lambda tool: tool if tool.wants_image(now) else None)
        if any(wanting):
            pixels = draw()
            for each in filter(None, wanting):
                self.call(each, lambda tool: tool.take_image(pixels, now))

    @property
    def saved_state(self) -> dict[str, Any]:
        found = {
            name: self.call(tool, lambda tool: tool.saved_state) for name, tool in self.items()
        }
        return {name: state for name, state in found.items() if state is not None}

    def restore_saved(self, states: Mapping[str, Any]) -> None:
        """Restores the saved states of tools. States that tools reject are ignored."""
        for name, state in states.items():
            with suppress(TypeError, ValueError, KeyError, AttributeError, IndexError):
                if name in self:
                    self[name].restore_saved(state)


class DrawnTool:
    """Adapts a tool to the interface of features of a `Decor`, see `decor.feature.Feature`."""

    def __init__(self, tool: Tool, tools: Tools) -> None:
        self._tool, self._tools = tool, tools

    def lay_out(self, frame: Frame) -> None:
        if self._tool in self._tools.values():
            self._tools.call(self._tool, lambda tool: tool.lay_out(frame))

    def draw(self, frame: Frame) -> None:
        if self._tool in self._tools.values():
            self._tools.call(self._tool, lambda tool: tool.draw(frame))


class Actions:
    """The actions of a window or page and of its tools, and the keys that perform them.

    If two actions have the same name or the same key, the second one is ignored with a warning in
    the log.
    """

    def __init__(
        self, own: Mapping[str, Action], tools: Tools, say: Callable[[str, bool], None]
    ) -> None:
        self._actions, self._tools, self._say = dict(own), tools, say
        self._keys = {**VIEWER_KEYS, **MORE_KEYS, **{key: Key(f"switch_{key}") for key in KEYS}}
        for name, tool in tools.items():
            for action, act in (tools.call(tool, lambda tool: tool.actions()) or {}).items():
                if action in self._actions:
                    log.warning(
                        "the action %s of the tool %s is ignored: the name is in use. "
                        "Rename the action, for example to %s_%s", action, name, name, action,
                    )  # fmt: skip
                    continue
                self._actions[action] = partial(self._act, tool, act)
        for name, tool in tools.items():
            for key, entry in tool.keys.items():
                action = entry[0]
                if key in self._keys:
                    log.warning("the key %s of the tool %s is ignored: it is in use", key, name)
                elif action not in self._actions:
                    log.warning("the tool %s has the key %s, but no action %s", name, key, action)
                self._keys.setdefault(key, Key(*entry))

    def _act(self, tool: Tool, act: Action) -> str | None:
        return self._tools.call(tool, lambda _: act())

    def add(self, own: Mapping[str, Action]) -> None:
        self._actions.update(own)

    def press(self, key: str, *, is_repeat: bool = False) -> None:
        """Performs the action of a key, if there is one."""
        found = self._keys.get(key)
        if found is not None and found.action in self._actions and found.repeats >= is_repeat:
            self.perform(found.action)

    def perform(self, action: str) -> None:
        """Performs an action, and shows the returned message or the error."""
        try:
            message = self._actions[action]()
        except SeroError as error:
            self._say(str(error), True)
            return
        if message:
            self._say(message, False)


def tool_kinds() -> dict[str, type[Tool]]:
    """Returns all installed tools by name, sorted by `order`. Failures to load one are logged."""
    return dict(sorted(load_all(TOOLS, Tool).items(), key=lambda each: (each[1].order, each[0])))


def tool_keys() -> dict[str, Key]:
    """Returns a mapping from the keys of all tools to actions, in the order of the tools."""
    return {key: Key(*entry) for kind in tool_kinds().values() for key, entry in kind.keys.items()}
