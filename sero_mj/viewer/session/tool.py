"""`Tool`: what a user does to a world that is shown, by pointer, keys and panel.

Jogging, pulling, undo and all others are found by entry points, one file each; a package adds one
in its pyproject.toml:

    [project.entry-points."sero_mj.tools"]
    measure = "my_package:Measure"
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
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
from ..panels.widgets import Widgets
from ..tools.joint_goal import JointGoal
from .clock import Clock
from .picking import Picked, Pixel
from .scene_decor import SceneDecor
from .view_state import ViewState

log = logging.getLogger(__name__)

Action = Callable[[], str | None]  # returns a message for the user
Found = TypeVar("Found")


class Shown(Protocol):
    """What a tool knows of the window or page that it works in.

    Attributes:
        mirror: what is shown, with its sources and routes.
        world: the compiled scene.
        data: its state; its frames are up to date when `draw` and what the pointer does are called.
        toggles: what is switched on.
        clock: pause, speed and time line.
        decor: of the last frame: what is at a pixel, and the camera's view.
        folder: where files of the user go; the current folder when None.
        view_camera: the camera; can be changed.
        is_following: whether the camera goes along with a frame.
        picture_size: width and height of screenshots, pixels.
        tools: all of them by name.
    """

    @property
    def mirror(self) -> LiveWorld: ...  # noqa: D102
    @property
    def world(self) -> WorldView: ...  # noqa: D102
    @property
    def data(self) -> mujoco.MjData: ...  # noqa: D102
    @property
    def toggles(self) -> Toggles: ...  # noqa: D102
    @property
    def clock(self) -> Clock: ...  # noqa: D102
    @property
    def decor(self) -> SceneDecor: ...  # noqa: D102
    @property
    def folder(self) -> Path | None: ...  # noqa: D102
    @property
    def view_camera(self) -> mujoco.MjvCamera: ...  # noqa: D102
    @property
    def is_following(self) -> bool: ...  # noqa: D102
    @property
    def picture_size(self) -> tuple[int, int]: ...  # noqa: D102
    @property
    def tools(self) -> Tools: ...  # noqa: D102

    def say(self, text: str, *, is_bad: bool = False) -> None:
        """Shows a message for a few seconds."""

    def select(self, joint: int) -> None:
        """Selects a joint: it is lit, and its torques are plotted."""

    def view_state(self) -> ViewState:
        """Camera, switches, selection and time, as text."""

    def render_words(self) -> list[str]:
        """Scene, camera and switches as arguments of `sero-mj render`."""

    def to_clipboard(self, text: str) -> None:
        """Puts a text onto the user's clipboard."""


class Grab(NamedTuple):
    """What a drag does that begins at a pixel.

    Attributes:
        text: for the user.
        is_refused: whether the text says why nothing is dragged there.
    """

    text: str
    is_refused: bool = False


class Tool:
    """A tool of one window or page; whatever it does not take part in is left as it is here.

    Pixels are those of the picture, y up.

    Args:
        shown: where it works.

    Attributes:
        order: among the others: of panels from above, of drags and keys who is asked first. Those
            of sero-mj have 10 to 90.
        keys: name of an action and words for the help, by key; no words for what it leaves out.
    """

    order: ClassVar[int] = 100
    keys: ClassVar[Mapping[str, tuple[str, str]]] = {}

    def __init__(self, shown: Shown) -> None:
        self.shown = shown

    def actions(self) -> Mapping[str, Action]:
        """What keys and menus do, by the names in `keys`."""
        return {}

    # ---- the pointer

    def click(self, picked: Picked | None, at: Pixel) -> str | None:
        """Takes a click; returns what to tell the user, or None where it is for others.

        Args:
            picked: the item there; None for the background.
            at: the pixel.
        """
        return None

    def hover(self, at: Pixel | None) -> bool:
        """Takes notice of the pointer; returns whether a drag from there would grab a handle.

        Args:
            at: the pixel; None outside of the picture, and while something is dragged.
        """
        return False

    def grab_handle(self, at: Pixel) -> Grab | None:
        """Begins a drag of a handle; None where there is none of this tool."""
        return None

    def grab(self, at: Pixel) -> Grab | None:
        """Begins a drag with Ctrl; None where there is nothing for this tool."""
        return None

    def announce(self, at: Pixel) -> Grab | None:
        """Says what `grab` would do there."""
        return None

    def move(self, at: Pixel) -> None:
        """Moves the pointer of the drag."""

    def drag(self) -> str:
        """Does what the drag is for, in every frame; returns what is in its way, or nothing."""
        return ""

    def release(self) -> None:
        """Ends the drag."""

    def wheel(self, notches: float) -> str | None:
        """Takes the wheel while this tool drags; returns what to tell, or None to zoom as ever."""
        return None

    # ---- frames

    def advance(self, passed: float) -> None:
        """Acts before the world moves on, s of real time after the last frame."""

    def watch(self) -> None:
        """Looks at a new state of what is live."""

    def lay_out(self, frame: Frame) -> None:
        """Adds panels to a frame, see `decor.feature.Feature`."""

    def draw(self, frame: Frame) -> None:
        """Adds geoms to a frame, see `decor.feature.Feature`."""

    def build(self, ui: Widgets) -> None:
        """Builds its part of the panel."""

    def ticks(self) -> Sequence[tuple[float, bool]]:
        """Marks on the time line: their times, s, and whether the user has set them."""
        return ()

    def next_message(self) -> tuple[str, bool] | None:
        """What to tell the user of work in the background, and whether it is bad; None for none."""
        return None

    # ---- what is kept

    @property
    def state(self) -> Any:
        """What undo takes back, of all that the user does with it; equal ones are one."""
        return ()

    def restore(self, state: Any) -> None:
        """Takes over a state of before."""

    def render_words(self) -> list[str]:
        """Arguments of `sero-mj render` with which a picture shows what it has changed."""
        return []

    def goal(self) -> tuple[str, JointGoal, Array] | None:
        """What the sticks of a gamepad move: its name, it, and T_world_base (4, 4)."""
        return None

    def close(self) -> None:
        """Frees what it holds, when window or page are closed."""


class Tools(Mapping[str, Tool]):
    """All tools of a window or page by name, in their order.

    What fails of another package is logged, told and taken out; the rest goes on.

    Args:
        shown: where they work.
    """

    def __init__(self, shown: Shown) -> None:
        self._shown = shown
        self._tools: dict[str, Tool] = {}
        for name, kind in sorted(tool_kinds().items(), key=lambda each: (each[1].order, each[0])):
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
        """Survives what a tool of another package raises."""
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
        """What all of them answer, in their order."""
        answers: list[Found] = []
        for name, tool in [*self._tools.items()]:
            with self._guarding(name, type(tool)):
                answers.append(act(tool))
        return answers

    def first(self, act: Callable[[Tool], Found | None]) -> tuple[Tool, Found] | None:
        """The first that answers, and what; None where none does."""
        for name, tool in [*self._tools.items()]:
            with self._guarding(name, type(tool)):
                answer = act(tool)
                if answer is not None:
                    return tool, answer
        return None


class DrawnTool:
    """A tool as something that is drawn: one that fails is told and taken out.

    Args:
        tool: of these.
        tools: all of them.
    """

    def __init__(self, tool: Tool, tools: Tools) -> None:
        self._tool, self._tools = tool, tools

    def lay_out(self, frame: Frame) -> None:
        """See `Tool`."""
        if self._tool in self._tools.values():
            self._tools.call(self._tool, lambda tool: tool.lay_out(frame))

    def draw(self, frame: Frame) -> None:
        """See `Tool`."""
        if self._tool in self._tools.values():
            self._tools.call(self._tool, lambda tool: tool.draw(frame))


def tool_kinds() -> dict[str, type[Tool]]:
    """All installed tools by name; logs those that cannot be loaded."""
    return load_all(TOOLS, Tool)


def tool_keys() -> dict[str, tuple[str, str]]:
    """Name of the action and words for the help, by key, of all tools in their order."""
    kinds = sorted(tool_kinds().items(), key=lambda each: (each[1].order, each[0]))
    return {key: entry for _, kind in kinds for key, entry in kind.keys.items()}
