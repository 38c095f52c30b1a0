"""`Tool`: a user interaction with the displayed world, by pointer, keys and panel.

Jogging, pulling, undo and all others are found by entry points, one file each; a package adds one
in its pyproject.toml:

    [project.entry-points."sero_mj.tools"]
    measure = "my_package:Measure"
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol, TypeVar

import mujoco

from ...base.errors import SeroError
from ...base.frames import Array
from ...base.plugins import TOOLS, is_own_class, load_all
from ...data.drive.mirror import LiveWorld
from ...robots.assemble.world_view import WorldView
from ..decor.feature import Frame
from ..decor.toggles import Toggles
from ..image.image_files import Pixels
from ..image.picking import Picked, Pixel
from ..image.scene_decor import SceneDecor
from .clock import Clock, Tick
from .joint_goal import JointGoal
from .keys import Key
from .status_line import Piece
from .view_state import ViewState
from .widgets import Widgets

log = logging.getLogger(__name__)

Action = Callable[[], str | None]  # returns a message for the user
Found = TypeVar("Found")


class Shown(Protocol):
    """The interface of the window or page to its tools.

    Attributes:
        mirror: the displayed mirror, with its sources and routes.
        data: its state; frames are up to date when `draw` and the pointer's methods are called.
        clock: pause, speed and time line.
        decor: of the last frame: items at pixels, and the camera's view.
        joint: the selected joint, its index in the world.
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
    shows_panel: bool

    @property
    def view_camera(self) -> mujoco.MjvCamera: ...
    @property
    def is_following(self) -> bool: ...
    @property
    def picture_size(self) -> tuple[int, int]: ...

    def say(self, text: str, is_bad: bool = False) -> None: ...

    def select(self, joint: int) -> None: ...

    def view_state(self) -> ViewState: ...

    def render_words(self) -> list[str]: ...

    def to_clipboard(self, text: str) -> None: ...


class Grab(NamedTuple):
    """The effect of a drag that begins at a pixel.

    Attributes:
        is_refused: whether the text says why nothing is dragged there.
    """

    text: str
    is_refused: bool = False


class PointerEvents:
    """What a tool does with the pointer; pixels are those of the picture, y up."""

    def click(self, picked: Picked | None, at: Pixel) -> str | None:
        """Handles a click; returns a message, or None to leave it to others."""
        return None

    def hover(self, at: Pixel | None) -> bool:
        """Handles the pointer; returns whether a drag from there would grab a handle.

        Args:
            at: the pixel; None outside of the picture, and while something is dragged.
        """
        return False

    def grab_handle(self, at: Pixel) -> Grab | None:
        """Begins a drag of a handle; None if this tool has none there."""
        return None

    def grab(self, at: Pixel) -> Grab | None:
        """Begins a drag with Ctrl; None if this tool has nothing to drag there."""
        return None

    def announce(self, at: Pixel) -> Grab | None:
        """Describes what `grab` would do there."""
        return None

    def move(self, at: Pixel) -> None:
        """Called when the pointer of a drag moves."""

    def drag(self) -> str:
        """Applies the drag, in every frame; returns what obstructs it, or an empty text."""
        return ""

    def release(self) -> None:
        """Called when the drag ends."""

    def wheel(self, notches: float) -> str | None:
        """Handles the wheel while this tool drags; returns a message, or None to zoom as usual."""
        return None


class KeptState:
    """What of a tool is undone, seen again at the next start, and rendered."""

    @property
    def state(self) -> Any:
        """The state for undo; equal states count as one."""
        return ()

    def restore(self, state: Any) -> None:
        """Restores an earlier state."""

    @property
    def kept(self) -> Any:
        """What its user sees again at the next start of this scene, for JSON; None for nothing."""
        return None

    def take_kept(self, kept: Any) -> None:
        """Takes over what was kept, as far as it fits; raises TypeError or so where it does not."""

    def render_words(self) -> list[str]:
        """Arguments of `sero-mj render` that reproduce its changes in a picture."""
        return []


class Tool(PointerEvents, KeptState):
    """A tool of one window or page; override the methods of the events it needs.

    Attributes:
        order: of panels from top to bottom, and of priority for drags and keys. Those of sero-mj
            have 10 to 90.
        keys: what keys do: `Key`, or name of an action and text for the help.
        shows_area: whether that is shown; users see it again at the next start.
    """

    order: ClassVar[int] = 100
    keys: ClassVar[Mapping[str, Key | tuple[str, str]]] = {}
    area: str = ""
    shows_area: bool = False

    def __init__(self, shown: Shown) -> None:
        self.shown = shown

    def actions(self) -> Mapping[str, Action]:
        """Actions of keys and menus, by the names in `keys`."""
        return {}

    @property
    def active(self) -> Collection[str]:
        """Names of the actions that are switched on, which menus mark."""
        return ()

    # ---- frames

    def advance(self, passed: float) -> None:
        """Acts before the world advances, `passed` s of real time after the last frame."""

    def watch(self) -> None:
        """Examines a new state, of a live source, a recording or a simulation."""

    @property
    def watches_closely(self) -> bool:
        """Whether it needs states of recordings and simulations between frames, too."""
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
        """Words over the picture while something goes on, and their mood; None for none."""
        return None

    def ticks(self) -> Sequence[Tick]:
        """Returns the marks of this tool on the timeline."""
        return ()

    def next_message(self) -> tuple[str, bool] | None:
        """A message about background work, and whether it is an error; None for none."""
        return None

    # ---- the program that has opened the view, see `sero_mj.view`

    def hear(self, message: Any) -> None:
        """Takes what that program sends it."""

    def answer(self) -> Any:
        """What it sends to that program, in every frame; None for nothing."""
        return None

    # ---- pictures

    @property
    def takes_pictures(self) -> bool:
        """Whether it takes pictures at this time: they are drawn in full, as without panels."""
        return False

    def wants_picture(self, now: float) -> bool:
        """Whether it takes the picture of this frame, at a time of `time.monotonic`, s."""
        return False

    def take_picture(self, pixels: Pixels, now: float) -> None:
        """Takes the picture of this frame, (height, width, 3), and its time, s."""

    def goal(self) -> tuple[str, JointGoal, Array] | None:
        """The goal moved by the sticks of a gamepad: its name, it, and T_world_base (4, 4)."""
        return None

    def close(self) -> None:
        """Releases resources when the window or page is closed."""


class Tools(Mapping[str, Tool]):
    """All tools of a window or page by name, in their order.

    A failing tool of another package is logged, reported and removed; the others continue.

    Args:
        shown: the window or page.
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
            log.exception("tool %s fails and is taken out", name)
            self._tools.pop(name, None)
            self._shown.say(f"{name} fails and is taken out: {error}", is_bad=True)

    def call(self, tool: Tool, act: Callable[[Tool], Found]) -> Found | None:
        """What one of them answers; None where it fails, and is taken out."""
        name = next((name for name, each in self._tools.items() if each is tool), "tool")
        answer: Found | None = None
        with self._guarding(name, type(tool)):
            answer = act(tool)
        return answer

    def ask(self, act: Callable[[Tool], Found]) -> list[Found]:
        """The results of all tools, in their order."""
        answers: list[Found] = []
        for name, tool in [*self._tools.items()]:
            with self._guarding(name, type(tool)):
                answers.append(act(tool))
        return answers

    def first(self, act: Callable[[Tool], Found | None]) -> tuple[Tool, Found] | None:
        for name, tool in [*self._tools.items()]:
            with self._guarding(name, type(tool)):
                answer = act(tool)
                if answer is not None:
                    return tool, answer
        return None

    @property
    def areas(self) -> list[Tool]:
        """The tools that show an area of their own."""
        return [tool for tool in self.values() if tool.area and tool.shows_area]

    @property
    def ticks(self) -> list[Tick]:
        return [tick for ticks in self.ask(lambda tool: tool.ticks()) for tick in ticks]

    @property
    def ongoing(self) -> Piece | None:
        """Words over the picture of what goes on, and their mood; None for none."""
        found = self.first(lambda tool: tool.ongoing())
        return None if found is None else found[1]

    @property
    def takes_pictures(self) -> bool:
        """Whether a tool takes pictures at this time."""
        return any(self.ask(lambda tool: tool.takes_pictures))

    def give_picture(self, draw: Callable[[], Pixels]) -> None:
        """Gives the current picture to the tools that want it; draws it only for these."""
        now = time.monotonic()
        wants = self.ask(lambda tool: tool if tool.wants_picture(now) else None)
        wanting = [tool for tool in wants if tool is not None]
        if wanting:
            pixels = draw()
            for each in wanting:
                self.call(each, lambda tool: tool.take_picture(pixels, now))

    @property
    def kept(self) -> dict[str, Any]:
        """What tools keep of the scene, by their names."""
        found = {name: self.call(tool, lambda tool: tool.kept) for name, tool in self.items()}
        return {name: kept for name, kept in found.items() if kept is not None}

    def take_kept(self, kept: Mapping[str, Any]) -> None:
        """Hands tools what they have kept; what does not fit is left out."""
        for name, of_tool in kept.items():
            with suppress(TypeError, ValueError, KeyError, AttributeError, IndexError):
                if name in self:
                    self[name].take_kept(of_tool)


class DrawnTool:
    """Lets a tool draw in every frame; one that fails is reported and removed."""

    def __init__(self, tool: Tool, tools: Tools) -> None:
        self._tool, self._tools = tool, tools

    def lay_out(self, frame: Frame) -> None:
        if self._tool in self._tools.values():
            self._tools.call(self._tool, lambda tool: tool.lay_out(frame))

    def draw(self, frame: Frame) -> None:
        if self._tool in self._tools.values():
            self._tools.call(self._tool, lambda tool: tool.draw(frame))


def tool_kinds() -> dict[str, type[Tool]]:
    """All installed tools by name, in their order; logs those that cannot be loaded."""
    return dict(sorted(load_all(TOOLS, Tool).items(), key=lambda each: (each[1].order, each[0])))


def tool_keys() -> dict[str, Key]:
    """What keys do, of all tools in their order."""
    return {key: Key(*entry) for kind in tool_kinds().values() for key, entry in kind.keys.items()}
