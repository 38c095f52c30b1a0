"""Shared by commands: parser, scene, settings, tables of output, interruption."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import re
import signal
import sys
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
from .options import add_options, read_options
from .terminal import make_console, plain

if TYPE_CHECKING:
    from rich.table import Table

    from ..data.record.recording import PacketFile
    from ..robots.declared.scene import Scene
    from ..simulate.runs.run_log import RunLog
    from ..simulate.scenario import Scenario

# Subparsers have no public type.
Commands = Any
T = TypeVar("T", bound=Options)


class OneLineParser(argparse.ArgumentParser):
    """A parser that reports an error in one line, as this program does everywhere."""

    def error(self, message: str) -> NoReturn:
        """Prints the line and exits with 2."""
        self.exit(2, printable(f"{self.prog}: {message}; see {self.prog} --help\n"))

    def _print_message(self, message: str, file: Any = None) -> None:
        # Help may be colored (from Python 3.14 on), and has no texts of files.
        super()._print_message(message, plain(file or sys.stderr))


def join_negative_values(arguments: list[str]) -> list[str]:
    """Joins `--camera -90,-20,3` with `=`, because argparse reads -90 as an option."""
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

    Args:
        name: name of the command.
        run: function of the options that returns the exit status.
        kind: declaration of the options. The first line of its docstring describes the command.
        text: help text. The first paragraph (the examples) precedes the options, the rest follows.
    """
    summary, *_ = str(kind.__doc__).splitlines()
    examples, _, notes = text.partition("\n\n")

    def run_with(given: argparse.Namespace) -> int:
        options = read_options(kind, vars(given))
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
        parser.set_defaults(run=run_with)

    return add_to


def check_ending(given: str, path: Path, endings: Collection[str]) -> None:
    """Raises UsageError for a file name with another ending; `given` is cited in the message."""
    if path.suffix.lower() not in endings:
        raise UsageError(f"{given}: expected a name that ends in {', '.join(endings)}")


def check_new(paths: Iterable[Path], hint: str) -> None:
    """Raises UsageError if one of these files exists; `hint` says what to do about it."""
    for path in paths:
        if path.exists():
            raise UsageError(f"{path} is there already; {hint}")


@contextlib.contextmanager
def writing() -> Iterator[None]:
    """Converts errors of writing a file, within the context, to UsageError."""
    try:
        yield
    except OSError as error:
        raise UsageError(f"cannot write {error.filename}: {error.strerror}") from error


def pace(done: int, begin: float, workers: int) -> str:
    """How many tasks are done per second since `begin`, and by how many workers."""
    rate = done / (time.perf_counter() - begin)
    return f"{rate:.1f}/s, {workers} {'worker' if workers == 1 else 'workers'}"


@contextlib.contextmanager
def progress_bar(
    what: str, *, quiet: bool, stays: bool = False, note: Callable[[], str] | None = None
) -> Iterator[Callable[[int, int], None]]:
    """Shows progress on a terminal; yields a function of the amount done and the total.

    `stays` keeps the bar at the end. `note` returns further text behind the bar.
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
        bar.start()  # only now: an error before leaves no empty bar
        bar.update(task, completed=done, total=total)

    try:
        yield update
    finally:
        if bar.live.is_started:
            bar.stop()


def overrides(settings: Sequence[str]) -> dict[str, Any]:
    """Parses `--set robot.field=value`: TOML, or numbers with commas; raises UsageError."""
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
    try:  # more lenient than TOML, which wants a digit before every point
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
    """Loads a scene by name, file or network address, applies `--set`, and prints its programs.

    See `load_scene` for `by_hand`, `trusted` and `replay`.
    """
    from ..load import load_scene

    name = network_scene(name) or name
    given = overrides(settings)
    with named_settings(given):
        scene = load_scene(name, given, by_hand=by_hand, trusted=trusted, replay=replay)
    for source in scene.sources.values():
        print_programs(getattr(getattr(source, "run", None), "scenario", None))
    return scene


def network_scene(name: str) -> str | None:
    """Writes a scene of the robot at an address, `ros2://` say; returns None for other names."""
    scheme, separator, _ = name.partition("://")
    if not separator or scheme not in plugins(NETWORKS):
        return None
    return str(load_plugin(NETWORKS, scheme).scene_of_network(name))


def print_programs(scenario: Scenario | None) -> None:
    """Prints what the simulation of a scenario starts or loads."""
    request = None if scenario is None else scenario.request()
    for action in () if request is None else request.actions:
        print(f"will {action}", file=sys.stderr, flush=True)


@contextlib.contextmanager
def named_settings(given: Mapping[str, Any], option: str = "--set") -> Iterator[None]:
    """Names the option in problems of fields that it has set."""
    try:
        yield
    except DeclarationError as error:
        problems = (_as_set(problem, given, option) for problem in error.problems)
        raise DeclarationError(list(dict.fromkeys(problems))) from None


def _as_set(problem: Problem, given: Mapping[str, Any], option: str) -> Problem:
    for target in given:
        field = target.partition(".")[2]
        # As keys stand in a scene, in a robot's own file, and where there is nothing to set.
        for key in filter(
            None, (rf"\w+\.{re.escape(target)}", re.escape(field), re.escape(target))
        ):
            if found := re.fullmatch(rf"{key}(\..+)?", problem.key):
                return replace(
                    problem, key=f"{option} {target}{found[1] or ''}", file=None, line=None
                )
        # A table on the way to it is wrong as a whole, or unknown.
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
    """Replaces every source of a scene that is in the recording by its replay.

    Args:
        scene: is changed.
        file: the recording, or a table.
        start: where to begin, s since the recording began; at its first packet when None.
        source: of a recording of ROS, that moves the robot of a scene without sources; of a table,
            the source of the scene whose packets it has.
        columns: of a table, `SIGNAL=COLUMNS`.

    Raises:
        RecordingError: it cannot be read.
        UsageError: it has none of the scene's sources, or ends before `start`.
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
        _check_source(scene, file, source)
    led = look_into(file).lead(scene, source)
    scene.robots, scene.sources, scene.routes = led.robots, led.sources, led.routes
    recording = look_into(file, topics_of(scene))
    recorded = {name: list(source.events) for name, source in recording.sources.items()}
    check_span(recording, start)
    both = [name for name in scene.sources if name in recorded]
    if not both:
        found = ", ".join(recorded) or "no source"
        expected = ", ".join(scene.sources) or "none: it has no sources"
        if recording.names_joints and len(recorded) > 1 and not scene.sources:
            there = recording.about_sources()
            raise UsageError(
                f"--replay {file} has several sources: {there}; it is not clear which moves scene "
                f"'{scene.name}'; choose with --source {next(iter(recorded))}, say, or by "
                "source or topics of a source of kind = 'replay' in the scene"
            )
        raise UsageError(f"--replay {file} has {found}; scene '{scene.name}' expects {expected}")
    for name in both:
        scene.sources[name] = recording.replay_table(name, topics_of(scene).get(name))
        scene.routes = routes_from_recording(scene.routes, name, recorded[name])
        if start is not None:
            scene.sources[name]["start"] = start


def _check_source(scene: Scene, file: Path, source: str) -> None:
    from ..data.record.formats import look_into

    if scene.sources:
        own = ", ".join(scene.sources)
        raise UsageError(
            f"--source {source}: scene '{scene.name}' has sources of its own, {own}, which are "
            "replayed by their names; leave it out"
        )
    look_into(file).choose_source(source)


def print_json(found: Any) -> None:
    """Prints JSON; NaN and infinity, which JSON does not have, become null."""
    print(json.dumps(finite(found), indent=2))


def finite(found: Any) -> Any:
    """Returns what JSON can have: NaN and infinity become None, and mappings dictionaries."""
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
    endless = console.options.update_width(10_000)
    console.width = max(console.width, console.measure(table, options=endless).maximum)
    console.print(table)


def read_recorded_run(
    path: Path,
    source: str | None,
    scene: Scene | None,
    robots: Sequence[str] = (),
    columns: Sequence[str] = (),
) -> RunLog:
    """Reads a recording or a table.

    Without a `scene` its robots are those in the recording. `source` limits it to one source, and
    `robots` to a scene with one of these names. `columns` are those of a table, `SIGNAL=COLUMNS`.
    """
    from ..data.record.csv_files import is_table, parse_columns
    from ..data.record.formats import open_recording
    from ..simulate.runs.run_recording import read_run

    if is_table(path):
        if scene is None:
            raise UsageError(f"{path} does not say what its robots are: give --scene SCENE")
        from ..simulate.runs.tables import find_tables

        return find_tables(path).read_run(path, scene, source, parse_columns(columns))
    if scene is None:
        with open_recording(path) as recording:
            found = list(recording.scenes("--scene NAME", source, robots))
        why: list[SeroError] = []
        for name in found:
            try:
                possible = read_scene(name)
                if not robots or not possible.robots.keys().isdisjoint(robots):
                    run = read_run(path, source, scene=possible)
                    if not robots:
                        note_choice(path, name)
                    return run
            except SeroError as error:
                why.append(error)
        if why:
            raise UsageError(paths.without_temporary(str(why[0])))
    try:
        return read_run(path, source, scene=scene)
    except RecordingError as error:
        if scene is None and "give" in error.reason:
            raise RecordingError(error.path, f"{error.reason}: --scene SCENE") from None
        raise


def note_choice(recording: Path, scene: str) -> None:
    """Prints a note that a shipped robot was chosen for a recording of ROS by its joints' names."""
    from ..data.record.formats import look_into

    if not paths.is_temporary(scene) and look_into(recording).names_joints:
        chosen = f"does not describe its robot; {scene} has the joints that it names"
        print(f"note: {recording} {chosen}", file=sys.stderr)


def check_span(recording: PacketFile, start: float | None, option: str = "--start") -> None:
    """Raises UsageError if a recording has no data from `start` on, in seconds."""
    from ..data.record.replay import check_start

    if start is not None:
        try:
            check_start(start, recording)
        except ValueError as error:
            raise UsageError(f"{option}: {error}") from None


@contextlib.contextmanager
def until_ended() -> Iterator[None]:
    """Lets Ctrl-C and SIGTERM (`kill`, `timeout`) end the context instead of the command."""
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
