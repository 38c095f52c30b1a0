"""`Tool`: a user interaction with the displayed world, by pointer, keys and panel.

Each tool is one file with an entry point. A package adds a tool in pyproject.toml:

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

Action = Callable[[], str | None]  # returns a message for the user
Found = TypeVar("Found")

# Old names of methods, supported for one version.
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
    """The window or page in which a tool works.

    Attributes:
        data: state of the mirror; frames are up to date when `draw` and the pointer's methods
            are called.
        clock: pause, speed and timeline.
        decor: decor of the last frame, with the items at pixels and the camera's view.
        joint: index of the selected joint in the world.
        is_window: whether this is a window, not a page.
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
    """The start of a drag.

    Attributes:
        text: message for the user.
        is_refused: whether nothing can be dragged, and the text explains why.
    """

    text: str
    is_refused: bool = False


class PointerEvents:
    """The pointer events of a tool. Pixels refer to the image, with y up."""

    def click(self, picked: Picked | None, at: Pixel) -> str | None:
        """Handles a click; returns a message for the user, or None to pass the click on."""
        return None

    def hover(self, at: Pixel | None) -> bool:
        """Called in every frame; returns whether a drag from this pixel would grab a handle.

        Args:
            at: pixel of the pointer; None outside the image or during a drag.
        """
        return False

    def grab_handle(self, at: Pixel) -> Grab | None:
        """Starts to drag a handle; returns None if this tool has none at the pixel."""
        return None

    def grab(self, at: Pixel) -> Grab | None:
        """Starts a drag with Ctrl; returns None if this tool has nothing to drag at the pixel."""
        return None

    def announce(self, at: Pixel) -> Grab | None:
        """Describes what `grab` would do at the pixel."""
        return None

    def move(self, at: Pixel) -> None:
        """Called when the pointer moves during a drag."""

    def drag(self) -> str:
        """Applies the drag, in every frame; returns what prevents it, or an empty string."""
        return ""

    def release(self) -> None:
        """Called when the drag ends."""

    def wheel(self, notches: float) -> str | None:
        """Handles the wheel during a drag; returns a message, or None if the camera should zoom."""
        return None


class ToolState:
    """The state of a tool that undo, the next start, or a copied command restores."""

    @property
    def state(self) -> Any:
        """State that undo restores; states are compared with `==`."""
        return ()

    def restore(self, state: Any) -> None:
        """Restores an earlier `state`."""

    @property
    def saved_state(self) -> Any:
        """State that the next start of the scene restores, as JSON data, or None."""
        return None

    def restore_saved(self, state: Any) -> None:
        """Restores a `saved_state`; raises TypeError, ValueError or LookupError to reject it."""

    def render_words(self) -> list[str]:
        """Returns the arguments of `sero-mj render` that reproduce the tool's changes."""
        return []


class Tool(PointerEvents, ToolState):
    """Base class of tools. Override the methods of the events that the tool handles.

    Attributes:
        order: position in the panel from top to bottom, and priority for drags and keys. Tools of
            sero-mj have the numbers 5 to 90.
        keys: mapping from keys to actions: a `Key`, or the name of the action and a help text.
        area: title of the area beside the image, or an empty string for no area.
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
        """Returns the actions of keys and menus, by the names in `keys`."""
        return {}

    @property
    def active(self) -> Collection[str]:
        """Names of the actions that are currently on; menus mark these actions."""
        return ()

    def help_rows(self) -> Sequence[Row]:
        """Returns the rows of a column in the help: input and effect; headings have no effect."""
        return ()

    # ---- frames

    def advance(self, passed: float) -> None:
        """Called before the world advances; `passed` is the real time since the last frame, s."""

    def watch(self) -> None:
        """Called for each new state of a live source, a recording or a simulation."""

    @property
    def needs_every_state(self) -> bool:
        """Returns whether `watch` also needs states of recordings or simulations between frames."""
        return False

    def lay_out(self, frame: Frame) -> None:
        """Adds panels to a frame, see `decor.feature.Feature`."""

    def draw(self, frame: Frame) -> None:
        """Adds geoms to a frame, see `decor.feature.Feature`."""

    def build(self, ui: Widgets) -> None:
        """Builds the section of this tool in the side panel, in every frame."""

    def build_area(self, ui: Widgets) -> None:
        """Builds the area of this tool beside the image, if `area` and `shows_area` are set."""

    def ongoing(self) -> Piece | None:
        """Returns the text over the image during, for example, a video recording, or None."""
        return None

    def ticks(self) -> Sequence[Tick]:
        """Returns the marks of this tool on the timeline."""
        return ()

    def next_message(self) -> tuple[str, bool] | None:
        """Returns a message about background work, with whether it is an error; or None."""
        return None

    # ---- messages from and to the program that has opened the view, see `sero_mj.view`

    def receive(self, message: Any) -> None:
        """Called with each message from the program."""

    def reply(self) -> Any:
        """Returns a message to the program, or None; called after every frame."""
        return None

    # ---- images

    @property
    def takes_images(self) -> bool:
        """Returns whether `take_image` needs frames in full quality and without panels."""
        return False

    def wants_image(self, now: float) -> bool:
        """Returns whether to pass this frame to `take_image`; `now` is `time.monotonic()`, s."""
        return False

    def take_image(self, pixels: Pixels, now: float) -> None:
        """Receives the image of this frame, shape (height, width, 3), and the time, s."""

    def goal(self) -> tuple[str, JointGoal, Array] | None:
        """Returns name, goal and T_world_base (4, 4) of the target for a gamepad, or None."""
        return None

    def close(self) -> None:
        """Releases resources when the window or page is closed."""


class Tools(Mapping[str, Tool]):
    """All tools of a window or page by name, sorted by `order`.

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
        """Returns the result of a call, or None if the tool fails and is removed."""
        name = next((name for name, each in self._tools.items() if each is tool), "tool")
        result: Found | None = None
        with self._guarding(name, type(tool)):
            result = act(tool)
        return result

    def call_all(self, act: Callable[[Tool], Found]) -> list[Found]:
        """Returns the results of all tools, in the order of the tools."""
        results: list[Found] = []
        for name, tool in [*self._tools.items()]:
            with self._guarding(name, type(tool)):
                results.append(act(tool))
        return results

    def first(self, act: Callable[[Tool], Found | None]) -> tuple[Tool, Found] | None:
        """Returns the first tool whose result is not None, and the result; or None."""
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
        """Passes the current image to the tools that want it; draws it only if a tool wants it."""
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
        """Restores the states of tools; ignores states that do not fit."""
        for name, state in states.items():
            with suppress(TypeError, ValueError, KeyError, AttributeError, IndexError):
                if name in self:
                    self[name].restore_saved(state)


class DrawnTool:
    """Adapts a tool to a feature of decor. A tool that fails is reported and removed."""

    def __init__(self, tool: Tool, tools: Tools) -> None:
        self._tool, self._tools = tool, tools

    def lay_out(self, frame: Frame) -> None:
        if self._tool in self._tools.values():
            self._tools.call(self._tool, lambda tool: tool.lay_out(frame))

    def draw(self, frame: Frame) -> None:
        if self._tool in self._tools.values():
            self._tools.call(self._tool, lambda tool: tool.draw(frame))


class Actions:
    """The actions of a window or page and of its tools by name, and the keys that perform them.

    If two actions have the same name, or two keys are the same, the second is ignored with a
    warning in the log.
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
                        "the action %s of the tool %s is ignored: the name is taken; "
                        "rename it, for example to %s_%s", action, name, name, action,
                    )  # fmt: skip
                    continue
                self._actions[action] = partial(self._act, tool, act)
        for name, tool in tools.items():
            for key, entry in tool.keys.items():
                action = entry[0]
                if key in self._keys:
                    log.warning("the key %s of the tool %s is ignored: it is taken", key, name)
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
        """Performs an action and shows the resulting message or error."""
        try:
            message = self._actions[action]()
        except SeroError as error:
            self._say(str(error), True)
            return
        if message:
            self._say(message, False)


def tool_kinds() -> dict[str, type[Tool]]:
    """Returns all installed tools by name, sorted by `order`; logs tools that cannot be loaded."""
    return dict(sorted(load_all(TOOLS, Tool).items(), key=lambda each: (each[1].order, each[0])))


def tool_keys() -> dict[str, Key]:
    """Returns the keys of all tools, in the order of the tools."""
    return {key: Key(*entry) for kind in tool_kinds().values() for key, entry in kind.keys.items()}
