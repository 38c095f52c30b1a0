"""`StartPage`: the recent views, included scenes and robots that a user can open.

`window/start_window.py` and `web/start_host.py` display the start page.
"""

from __future__ import annotations

import logging
import queue
import time
import tomllib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, Self

from ...base import paths
from ...base.errors import SeroError
from ...base.frames import Array, Ints
from ...base.paths import model_name, without_temporary
from ...data.drive.mirror import Mirror
from ...data.receive.reception import QUIET_AFTER
from ...data.receive.source import Source, make_source
from ...data.receive.structure import Rows
from ..session.recent_views import RecentView, recent_views
from ..session.status_line import Message, Mood

log = logging.getLogger(__name__)

# An opener opens a view or file. If it raises a SeroError, the start page shows the message.
Opener = Callable[[RecentView | Path], Mirror]

TITLE = "sero-mj"
TAGLINE = "displays the joint torques of a robot, live or simulated"
DROP_HINT = (
    "Drop a file here: a robot (URDF, MJCF, robot.toml), a scene or scenario (TOML, X3D), "
    "or a recording (MCAP)"
)
SEARCH_HINT = "search scenes and robots"
MORE_HINT = "All scenes and robots: sero-mj list. All commands: sero-mj --help."
# These robots are parts of other robots, so they are listed last.
_PARTS = ("biped_leg", "dlr_hand2_finger", "hit_finger", "justin_head", "justin_torso",
          "justin_wheel", "space_justin_torso", "ups_leg")  # fmt: skip
# The start page may open sources of these kinds, because they send nothing.
_LISTENING_KINDS = ("udp", "shm")
_ERROR_TIME, _OPENING_TIME = 12.0, 60.0  # display times of messages, s


class Tile(NamedTuple):
    """An item of the start page that the user can open.

    Attributes:
        about: one-line description.
        image: path of the preview image, or None.
    """

    view: RecentView
    title: str
    about: str
    image: Path | None


class Section(NamedTuple):
    """A group of tiles with a title on the start page."""

    title: str
    tiles: list[Tile]


def sections() -> list[Section]:
    """Returns all sections of the start page that are not empty, with recent views first."""
    models, parts, scenes = paths.list_models(), set(_PARTS), paths.list_scenes()
    found = [
        Section("Recent views", [_recent_tile(view) for view in recent_views()]),
        Section("Simulations", [_tile(name) for name in paths.list_scenarios()]),
        Section("Live robots", [_tile(name) for name in scenes]),
        Section(
            "Robots",
            [
                *(_tile(name) for name in models if name not in parts),
                *(
                    _group_tile(name, is_hidden=name in scenes)
                    for name in paths.list_group_models()
                ),
            ],
        ),
        Section("Parts of robots", [_tile(name) for name in models if name in parts]),
    ]
    return [section for section in found if section.tiles]


def _tile(name: str) -> Tile:
    about = _about(paths.shipped_file(name))
    return Tile(RecentView(name), name, about, _shipped_image(name))


def _group_tile(name: str, *, is_hidden: bool) -> Tile:
    file = paths.models_dir() / name / paths.GROUP_FILE
    view = RecentView(str(file) if is_hidden else name)
    return Tile(view, name, _about(file), _shipped_image(name))


def _recent_tile(view: RecentView) -> Tile:
    image = view.image if view.image.is_file() else _shipped_image(view.scene)
    if view.replay:
        return Tile(view, Path(view.replay).name, f"recording, shown in {view.scene}", image)
    file = paths.shipped_file(view.scene)
    if file is not None:
        return Tile(view, view.scene, _about(file), image)
    path = Path(view.scene)
    is_model = path.name in (paths.ROBOT_FILE, paths.GROUP_FILE)
    title = model_name(path) if is_model else path.name
    return Tile(view, title, str(path.parent), image)


def _shipped_image(name: str) -> Path | None:
    image = paths.scenes_dir() / "pictures" / f"{Path(name).name}.jpg"
    return image if image.is_file() else None


def _about(file: Path | None) -> str:
    if file is None:
        return ""
    text = file.read_text(encoding="utf-8")
    described = tomllib.loads(text).get("description")
    first = text.partition("\n")[0]
    return str(described or (first.lstrip("# ") if first.startswith("#") else ""))


class ExpectedPackets(NamedTuple):
    """The packets that scenes expect at one address.

    Attributes:
        where: description of the address.
        views: mapping from packet sizes in bytes to the views that show packets of this size.
        rates: mapping from packet sizes in bytes to the number of packets received per second.
        trouble: reason why no packets can be received at the address, or an empty string.
    """

    where: str
    views: Mapping[int, Sequence[RecentView]]
    rates: Mapping[int, float]
    trouble: str

    @property
    def command(self) -> str:
        """Command that sends example packets to this address, for a test.

        It is empty if the address already receives packets, or if it cannot receive any.
        """
        if self.rates or self.trouble:
            return ""
        return f"sero-mj send {self.views[min(self.views)][0].scene}"

    @property
    def packets(self) -> str:
        """Text with the expected packet sizes and, for each size, the scenes that show it."""
        parts: list[str] = []
        for size, views in sorted(self.views.items()):
            names = ", ".join(Path(view.scene).name for view in views)
            parts.append(f"{size}{'' if parts else ' bytes'} ({names})")
        return " or ".join(parts)

    @property
    def text(self) -> str:
        if self.trouble:
            return self.trouble
        if not self.rates:
            return f"{self.where}: no packets yet"
        found = (
            f"{rate:.0f}/s of {size} bytes{'' if size in self.views else ' (unexpected size)'}"
            for size, rate in sorted(self.rates.items())
        )
        return f"{self.where}: {' and '.join(found)}"

    @property
    def mood(self) -> Mood:
        if self.trouble or not self.rates.keys() <= self.views.keys():
            return "bad"
        return "good" if self.rates else "plain"

    @property
    def shown(self) -> list[RecentView]:
        return [view for size, views in self.views.items() if size in self.rates for view in views]


class _Place:
    """An address at which scenes expect packets, with packet counts by packet size."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.views: dict[int, list[RecentView]] = {}  # keys: packet sizes
        self.trouble = ""
        self._counts: dict[int, Counter[int]] = {}  # packets per second, by packet size
        self._last: dict[int, float] = {}

    def open(self) -> None:
        self.source.record_to(self._count)
        try:
            self.source.open()
        except SeroError as error:
            self.trouble = str(error).removeprefix(f"source '{self.source.name}': ")

    def close(self) -> None:
        self.source.record_to(None)
        self.source.close()

    def _count(self, rows: Rows, lengths: Ints, arrivals: Array) -> None:
        now = time.monotonic()
        for size, count in Counter(lengths.tolist()).items():
            self._counts.setdefault(size, Counter())[int(now)] += count
            self._last[size] = now

    def expected(self) -> ExpectedPackets:
        now = time.monotonic()
        rates = {}
        for size, last in [*self._last.items()]:
            counts = self._counts[size]
            if now - last < 2.0 * QUIET_AFTER:
                rates[size] = float(max(counts[int(now) - 1], counts[int(now)]))
        return ExpectedPackets(self.source.about, self.views, rates, self.trouble)


class PortMonitor:
    """Context manager that counts the packets arriving at the addresses of scenes."""

    def __init__(self, views: list[RecentView]) -> None:
        self._places: dict[object, _Place] = {}
        for view in views:
            for source in _sources(view.scene):
                key = source.place or source.memory or source.about
                place = self._places.setdefault(key, _Place(source))
                place.views.setdefault(source.size, []).append(view)
        for place in self._places.values():
            for each in place.views.values():
                each.sort(key=lambda view: len(view.scene))  # The simplest scene has a short name.

    def __enter__(self) -> Self:
        for place in self._places.values():
            place.open()
        return self

    def __exit__(self, *exc: object) -> None:
        for place in self._places.values():
            place.close()

    def expected(self) -> list[ExpectedPackets]:
        """Returns the expected packets of each address. Addresses with packets come first."""
        found = [place.expected() for place in self._places.values()]
        return sorted(found, key=lambda each: (not each.rates, each.where))


def listening() -> PortMonitor:
    """Returns a monitor of the ports of all included and recent scenes."""
    recent = [view for view in recent_views() if not view.replay]
    shipped = [RecentView(name) for name in paths.list_scenes()]
    return PortMonitor(list(dict.fromkeys([*recent, *shipped])))


def _sources(scene: str) -> list[Source]:
    path = paths.shipped_file(scene) or Path(scene)
    if path.suffix != ".toml":
        return []
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8")).get("sources", {})
    except (OSError, ValueError):
        return []
    found: list[Source] = []
    if isinstance(tables, Mapping):
        for name, table in tables.items():
            if isinstance(table, Mapping) and table.get("kind") in _LISTENING_KINDS:
                with suppress(SeroError):
                    found.append(make_source(name, {**table, "debug_level": 0}))
    return found


class StartPage:
    """The contents of the start page, and the scene that the user has chosen.

    Attributes:
        chosen: mirror of the opened scene, or None.
        tiles: tiles of all sections.
        notice: last message to the user.
    """

    def __init__(self, opener: Opener, listening: PortMonitor) -> None:
        self._opener, self._listening = opener, listening
        self._sections = sections()
        self.tiles = [tile for section in self._sections for tile in section.tiles]
        self.notice = Message()
        self.chosen: Mirror | None = None
        self._wanted: queue.SimpleQueue[RecentView | Path] = queue.SimpleQueue()

    def expected(self) -> list[ExpectedPackets]:
        return self._listening.expected()

    def found(self, words: str) -> list[Section]:
        """Returns the sections with only those tiles whose text contains all words."""
        each = words.lower().split()
        found = [
            Section(title, [tile for tile in tiles if _has(tile, each)])
            for title, tiles in self._sections
        ]
        return [section for section in found if section.tiles]

    def choose(self, what: RecentView | Path) -> None:
        """Requests that `open_next` opens a view or file. Can be called from any thread."""
        name = what.name if isinstance(what, Path) else Path(what.replay or what.scene).name
        self.notice = Message(f"opening {name} ...", until=time.monotonic() + _OPENING_TIME)
        self._wanted.put(what)

    @property
    def is_opening(self) -> bool:
        return not self._wanted.empty()

    def open_next(self, patience: float) -> bool:
        """Opens the next requested view or file, and returns whether a scene is now open.

        Args:
            patience: maximum time to wait for a request in seconds.
        """
        try:
            self.chosen = self._opener(self._wanted.get(timeout=patience))
        except queue.Empty:
            pass
        except SeroError as error:
            self._refuse(without_temporary(str(error)))
        except Exception as error:  # A malformed file must not end the viewer.
            log.exception("a file cannot be opened")
            self._refuse(f"the file cannot be opened: {type(error).__name__}: {error}")
        return self.chosen is not None

    def _refuse(self, text: str) -> None:
        until = time.monotonic() + _ERROR_TIME
        self.notice = Message(text, is_bad=True, until=until)


def _has(tile: Tile, words: Sequence[str]) -> bool:
    text = f"{tile.title} {tile.about}".lower()
    return all(word in text for word in words)
