"""Functions that commands share, for parsing, reading, output and interruption."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import re
import shutil
import signal
import sys
import textwrap
import threading
import time
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import numpy as np

from ..base import paths
from ..base.errors import (
    DeclarationError,
    Problem,
    RecordingError,
    SeroError,
    UsageError,
    printable,
)
from ..base.options import Options
from ..base.plugins import NETWORKS, load_plugin, plugins
from .options import add_options, read_options, usage_of
from .terminal import make_console, plain

if TYPE_CHECKING:
    from rich.table import Table

    from ..data.record.recording import PacketFile
    from ..robots.declared.scene import Scene
    from ..simulate.runs.run_log import RunLog
    from ..simulate.scenario import Scenario

_MIN_WIDTH = 40  # of wrapped lines, characters
# Subparsers have no public type.
Commands = Any
T = TypeVar("T", bound=Options)


class OneLineParser(argparse.ArgumentParser):
    """A parser that reports an error in one line and exits with 2."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, printable(f"{self.prog}: {message}; see {self.prog} --help\n"))

    def _print_message(self, message: str, file: Any = None) -> None:
        # From Python 3.14 on, help has colors, which must not be escaped.
        super()._print_message(message, plain(file or sys.stderr))


def join_negative_values(arguments: list[str]) -> list[str]:
    """Converts `--camera -90` to `--camera=-90`, because argparse reads `-90` as an option."""
    joined: list[str] = []
    for argument in arguments:
        option = joined[-1] if joined else ""
        if re.match(r"-[\d.]", argument) and option.startswith("--") and "=" not in option:
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def command(
    name: str, run: Callable[[T], int], kind: type[T], text: str
) -> Callable[[Commands], None]:
    """Returns the function that adds a command to the program's parser.

    `run` returns the exit status. The first line of the docstring of `kind` describes the command.
    In the help, the first paragraph of `text` (the examples) precedes the options, and the other
    paragraphs follow them.
    """
    summary, *_ = str(kind.__doc__).splitlines()
    examples, _, notes = text.partition("\n\n")

    def run_with(arguments: argparse.Namespace) -> int:
        options = read_options(kind, vars(arguments))
        options.apply()
        return run(options)

    def add_to(commands: Commands) -> None:
        parser = commands.add_parser(
            name,
            help=summary[0].lower() + summary[1:].removesuffix("."),
            description=f"{summary}\n\n{examples.rstrip()}",
            epilog=notes,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        add_options(parser, kind)
        parser.usage = f"{parser.prog} [options] {usage_of(kind)}".rstrip()
        parser.set_defaults(run=run_with)

    return add_to


def check_ending(option: str, path: Path, endings: Collection[str]) -> None:
    """Raises UsageError, with `option` in the message, if a file name has another ending."""
    if path.suffix.lower() not in endings:
        raise UsageError(f"{option}: expected a name that ends in {', '.join(endings)}")


def check_new(paths: Iterable[Path], hint: str) -> None:
    """Raises UsageError if one of the files exists; `hint` is the remedy in the message."""
    for path in paths:
        if path.exists():
            raise UsageError(f"{path} already exists; {hint}")


@contextlib.contextmanager
def writing() -> Iterator[None]:
    """Converts an OSError within the context to a UsageError that names the file."""
    try:
        yield
    except OSError as error:
        raise UsageError(f"cannot write {error.filename}: {error.strerror}") from error


def pace(done: int, begin: float, workers: int) -> str:
    """Returns a text with the completed tasks per second and the number of workers.

    `begin` is the start time from `time.perf_counter`.
    """
    rate = done / (time.perf_counter() - begin)
    return f"{rate:.1f}/s, {workers} {'worker' if workers == 1 else 'workers'}"


@contextlib.contextmanager
def progress_bar(
    what: str, *, quiet: bool, stays: bool = False, note: Callable[[], str] | None = None
) -> Iterator[Callable[[int, int], None]]:
    """Shows a progress bar on a terminal.

    Yields a function that updates the bar; its arguments are the completed and the total amount.
    If `stays` is true, the bar remains visible at the end. `note` returns a text to show after the
    bar.
    """
    from rich import progress as bars
    from rich.table import Column
    from rich.text import Text

    class Note(bars.ProgressColumn):
        def render(self, task: bars.Task) -> Text:
            return Text(note() if note else "")

    console = make_console(stderr=True)
    bar = bars.Progress(
        bars.TextColumn("{task.description}", markup=False),
        bars.BarColumn(),
        bars.MofNCompleteColumn(),
        bars.TimeRemainingColumn(),
        *([] if note is None else [Note(Column(no_wrap=True))]),
        console=console,
        disable=quiet or not (stays or console.is_terminal),
        transient=not stays,
    )
    task = bar.add_task(what, total=None)

    def update(done: int, total: int) -> None:
        bar.start()  # an error before the first update must not leave an empty bar
        bar.update(task, completed=done, total=total)

    try:
        yield update
    finally:
        if bar.live.is_started:
            bar.stop()


def overrides(settings: Sequence[str]) -> dict[str, Any]:
    """Parses the settings of `--set ROBOT.FIELD=VALUE`; returns a mapping from keys to values.

    A value is TOML, numbers separated by commas, or plain text. Raises UsageError for a setting
    without a key or `=`.
    """
    result: dict[str, Any] = {}
    wrong = []
    for setting in settings:
        key, equals, text = setting.partition("=")
        if not equals or not key.strip():
            wrong.append(f"--set {setting}")
        result[key.strip()] = _value(text.strip())
    if wrong:
        expected = "expected ROBOT.FIELD=VALUE, e.g. lwr.show_axes=true"
        raise UsageError(f"{', '.join(wrong)}: {expected}")
    return result


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        pass
    try:  # more lenient than TOML, which requires a digit before every point
        return [float(part) for part in text.split(",")]
    except ValueError:
        return text


def read_scene(
    name: str,
    settings: Sequence[str] = (),
    *,
    by_hand: bool = False,
    trusted: bool = False,
    replay: Path | None = None,
) -> Scene:
    """Loads a scene by name, file or network address, and applies the settings of `--set`.

    Prints the programs that a scenario of the scene starts. The other parameters are those of
    `load_scene`.
    """
    from ..load import load_scene

    name = network_scene(name) or name
    values = overrides(settings)
    with named_settings(values):
        scene = load_scene(name, values, by_hand=by_hand, trusted=trusted, replay=replay)
    for source in scene.sources.values():
        print_programs(getattr(getattr(source, "run", None), "scenario", None))
    return scene


def network_scene(name: str) -> str | None:
    """Writes a scene for the robot at an address such as `ros2://HOST`, and returns the file.

    Returns None if `name` is not an address.
    """
    scheme, separator, _ = name.partition("://")
    if not separator or scheme not in plugins(NETWORKS):
        return None
    return str(load_plugin(NETWORKS, scheme).scene_of_network(name))


def print_programs(scenario: Scenario | None) -> None:
    """Prints the programs that a scenario starts and the libraries that it loads."""
    request = None if scenario is None else scenario.request()
    for action in () if request is None else request.actions:
        print(f"will {action}", file=sys.stderr, flush=True)


@contextlib.contextmanager
def named_settings(settings: Mapping[str, Any], option: str = "--set") -> Iterator[None]:
    """Makes errors in overridden fields name the option, as in `--set lwr.home`, not the file."""
    try:
        yield
    except DeclarationError as error:
        problems = (_as_set(problem, settings, option) for problem in error.problems)
        raise DeclarationError(list(dict.fromkeys(problems))) from None


def _as_set(problem: Problem, settings: Mapping[str, Any], option: str) -> Problem:
    for target in settings:
        escaped = re.escape(target)
        # The key can be that of a scene, of a robot file, or of an unknown robot.
        for key in (rf"\w+\.{escaped}", re.escape(target.partition(".")[2]), escaped):
            if key and (found := re.fullmatch(rf"{key}(\..+)?", problem.key)):
                own = f"{option} {target}{found[1] or ''}"
                return replace(problem, key=own, file=None, line=None)
        # The problem is about a table that contains the field.
        inside = problem.key, problem.key.partition(".")[2]
        if any("." in key and target.startswith(f"{key}.") for key in inside):
            return Problem(f"{option} {target}", problem.message)
    return problem


def replay_instead(
    scene: Scene,
    file: Path,
    start: float | None,
    source: str | None = None,
    columns: Sequence[str] = (),
) -> None:
    """Replaces the sources of a scene by replays of a recording or table.

    Args:
        scene: scene to modify.
        file: recording or table.
        start: start time in seconds since the recording began; None for the first packet.
        source: for a ROS recording and a scene without sources, the recorded source that moves the
            robot; for a table, the source of the scene that the table replaces.
        columns: texts `SIGNAL=COLUMNS` that assign the columns of a table.

    Raises:
        RecordingError: the recording cannot be read.
        UsageError: the recording has none of the scene's sources, or ends before `start`.
    """
    from ..data.drive.wiring import topics_of
    from ..data.record.csv_files import is_table, parse_columns
    from ..data.record.formats import look_into
    from ..simulate.runs.run_log import routes_from_recording

    if is_table(file):
        from ..simulate.runs.tables import find_tables

        find_tables(file).move_scene(scene, file, parse_columns(columns), start, source)
        return
    if source is not None:
        if scene.sources:
            own = ", ".join(scene.sources)
            reason = f"scene '{scene.name}' has its own sources ({own}), which are replayed by name"
            raise UsageError(f"--source {source}: {reason}. Remove --source.")
        look_into(file).choose_source(source)
    moved = look_into(file).move_robot(scene, source)
    scene.robots, scene.sources, scene.routes = moved.robots, moved.sources, moved.routes
    recording = look_into(file, topics_of(scene))
    recorded = {name: list(source.events) for name, source in recording.sources.items()}
    check_span(recording, start)
    both = [name for name in scene.sources if name in recorded]
    if not both:
        found = ", ".join(recorded) or "no source"
        expected = ", ".join(scene.sources) or "no source"
        if recording.names_joints and len(recorded) > 1 and not scene.sources:
            there = recording.about_sources()
            raise UsageError(
                f"--replay {file} has several sources: {there}. Choose the one that moves scene "
                f"'{scene.name}', for example with --source {next(iter(recorded))}, or declare a "
                "source of kind = 'replay' with source or topics in the scene."
            )
        raise UsageError(f"--replay {file} has {found}; scene '{scene.name}' expects {expected}")
    for name in both:
        scene.sources[name] = recording.replay_table(name, topics_of(scene).get(name))
        scene.routes = routes_from_recording(scene.routes, name, recorded[name])
        if start is not None:
            scene.sources[name]["start"] = start


def print_json(found: Any) -> None:
    """Prints a value as JSON, with null for NaN and infinity."""
    print(json.dumps(finite(found), indent=2))


def finite(found: Any) -> Any:
    """Returns a copy of a value for JSON, with None for NaN and infinity."""
    if isinstance(found, Mapping):
        return {key: finite(value) for key, value in found.items()}
    if isinstance(found, list | tuple):
        return [finite(value) for value in found]
    if isinstance(found, np.generic):
        found = found.item()
    return None if isinstance(found, float) and not math.isfinite(found) else found


def print_table(table: Table) -> None:
    """Prints a table in full width, even if the terminal or pipe is narrower."""
    console = make_console()
    unlimited = console.options.update_width(10_000)
    console.width = max(console.width, console.measure(table, options=unlimited).maximum)
    console.print(table)


def print_wrapped(lines: Iterable[str]) -> None:
    """Prints lines, wrapped to the width of the terminal."""
    width = max(shutil.get_terminal_size().columns, _MIN_WIDTH)
    for line in lines:  # a number and the percent sign stay together
        whole = line.replace(" %", "\u00a0%")
        text = textwrap.fill(whole, width, subsequent_indent="  ", break_on_hyphens=False)
        print(text.replace("\u00a0%", " %"))


def read_recorded_run(
    path: Path,
    source: str | None,
    scene: Scene | None,
    robots: Sequence[str] = (),
    columns: Sequence[str] = (),
) -> RunLog:
    """Reads the run in a recording or a table.

    If `scene` is None, the recording determines the scene, which must contain one of `robots`
    unless `robots` is empty. `source` selects one source of the recording. `columns` contains texts
    `SIGNAL=COLUMNS` that assign the columns of a table.
    """
    from ..data.record.csv_files import is_table, parse_columns
    from ..data.record.formats import open_recording
    from ..simulate.runs.run_recording import read_run

    if is_table(path):
        if scene is None:
            raise UsageError(
                f"{path}: a table does not describe its robots; add --scene with a scene, the name "
                "of a robot, or a robot file (TOML, URDF, MJCF)"
            )
        from ..simulate.runs.tables import find_tables

        return find_tables(path).read_run(path, scene, source, parse_columns(columns))
    if scene is None:
        with open_recording(path) as recording:
            found = list(recording.scenes("--scene NAME", source, robots))
        errors: list[SeroError] = []
        for name in found:
            try:
                possible = read_scene(name)
                if not robots or not possible.robots.keys().isdisjoint(robots):
                    run = read_run(path, source, scene=possible)
                    if not robots:
                        note_choice(path, name)
                    return run
            except SeroError as error:
                errors.append(error)
        if errors:
            raise UsageError(paths.without_temporary(str(errors[0])))
    try:
        return read_run(path, source, scene=scene)
    except RecordingError as error:
        if scene is None and error.needs_scene:
            raise RecordingError(error.path, f"{error.reason} with --scene SCENE") from None
        raise


def note_choice(recording: Path, scene: str) -> None:
    """Prints a note if an included robot was chosen for a ROS recording by its joint names."""
    from ..data.record.formats import look_into

    if not paths.is_temporary(scene) and look_into(recording).names_joints:
        chosen = f"does not describe its robot; using {scene}, which has the same joint names"
        print(f"note: {recording} {chosen}", file=sys.stderr)


def check_span(recording: PacketFile, start: float | None, option: str = "--start") -> None:
    """Raises UsageError, with `option` in the message, if no data follow `start` (seconds)."""
    from ..data.record.replay import check_start

    if start is not None:
        try:
            check_start(start, recording)
        except ValueError as error:
            raise UsageError(f"{option}: {error}") from None


@contextlib.contextmanager
def until_ended() -> Iterator[None]:
    """Ends only the context, not the command, at Ctrl+C and SIGTERM (`kill`, `timeout`)."""
    if threading.current_thread() is not threading.main_thread():
        with contextlib.suppress(KeyboardInterrupt):
            yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with contextlib.suppress(KeyboardInterrupt):
            yield
    finally:
        signal.signal(signal.SIGTERM, before)
