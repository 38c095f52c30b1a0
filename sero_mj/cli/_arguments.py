"""What several commands have in common: options, the scene they name, and how they end."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import re
import signal
import threading
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..base.errors import DeclarationError, Problem, RecordingError, UsageError
from ..robots.importers.package_files import ARGUMENTS_VARIABLE, PACKAGES_VARIABLE

if TYPE_CHECKING:
    from rich.table import Table

    from ..data.record.recording import Recording
    from ..robots.assemble.scene import Scene
    from ..simulate.runs.run_log import RunLog

# Subparsers have no public type.
Commands = Any
LOOKS = ("light", "dark")
QUALITIES = ("draft", "normal", "fine")
STEREO = ("side-by-side", "anaglyph")  # as in `viewer.stereo`, which takes a while to import
EYE_DISTANCE = 0.065
DEFAULT_SIZE = (1280, 800)


class OneLineParser(argparse.ArgumentParser):
    """A parser whose errors are one line, like all others of this program."""

    def error(self, message: str) -> NoReturn:
        """Prints the line and exits with 2."""
        self.exit(2, f"{self.prog}: {message}; see {self.prog} --help\n")


def join_negative_values(arguments: list[str]) -> list[str]:
    """Puts `--camera -90,-20,3` as `--camera=-90,-20,3`, for argparse takes -90 for an option."""
    joined: list[str] = []
    for argument in arguments:
        option = joined[-1] if joined else ""
        if re.match(r"-[\d.]", argument) and option.startswith("--") and "=" not in option:
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def add_command(commands: Commands, name: str, run: Any, summary: str, epilog: str) -> Any:
    """Adds a command whose help shows its summary and its epilog as they are written.

    `run` gets the parsed options and returns the exit status; the summary has no full stop.
    """
    parser = commands.add_parser(
        name,
        help=summary,
        description=summary[0].upper() + summary[1:] + ".",
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run)
    return parser


def positive(text: str) -> float:
    """A finite number above 0, for argparse."""
    return _number(text, "a number above 0", lambda value: value > 0)


def not_negative(text: str) -> float:
    """A finite number from 0, for argparse."""
    return _number(text, "0 or a number above", lambda value: value >= 0)


def _number(text: str, expected: str, fits: Callable[[float], bool]) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and fits(value)):
        raise argparse.ArgumentTypeError(f"found '{text}'; expected {expected}")
    return value


def check_whole(text: str, expected: str, least: int, most: int = 10**15 - 1) -> int:
    """A whole number in a range, for argparse; `expected` says which."""
    if text.isdecimal() and len(text) <= 15 and least <= int(text) <= most:
        return int(text)
    raise argparse.ArgumentTypeError(f"found '{text}'; expected {expected}")


def port(text: str) -> int:
    """A port from 1 to 65535, for argparse."""
    return check_whole(text, "a port from 1 to 65535", 1, 65535)


def seed(text: str) -> int:
    """A seed of random numbers, for argparse."""
    return check_whole(text, "a whole number from 0", 0, 2**32 - 1)


def size(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT in pixels, for argparse."""
    width, _, height = text.lower().partition("x")
    if width.isdecimal() and height.isdecimal() and int(width) and int(height):
        return int(width), int(height)
    raise argparse.ArgumentTypeError(f"found '{text}'; expected WIDTHxHEIGHT, e.g. 1280x800")


def numbers(text: str, what: str) -> NDArray[np.float64]:
    """Comma-separated finite numbers; raises UsageError."""
    try:
        values = np.array([float(part) for part in text.strip("[] ").split(",")])
    except ValueError:
        values = np.array([np.nan])
    if not np.isfinite(values).all():
        raise UsageError(f"{what}: found '{text}'; expected numbers with commas, e.g. 0,0.5,-1.2")
    return values


def refuse(options: argparse.Namespace, names: Sequence[str], why: str) -> None:
    """Raises UsageError where one of these options is given: its name, and why not."""
    for name in names:
        if getattr(options, name) is not None:
            raise UsageError(f"--{name}{why}")


def check_ending(given: str, path: Path, endings: Collection[str], between: str = " or ") -> None:
    """Raises UsageError for a file name that ends otherwise; `given` is what is cited."""
    if path.suffix.lower() not in endings:
        raise UsageError(f"{given}: expected a name that ends in {between.join(endings)}")


def add_scene_options(parser: argparse.ArgumentParser) -> None:
    """Adds `--camera`, `--look`, `--package`, `--set`, `--replay` and `--start`."""
    parser.add_argument(
        "--camera",
        metavar="CAM",
        help="name of a camera, or azimuth,elevation,distance in degrees and m",
    )
    parser.add_argument("--look", choices=LOOKS, help="over the scene's; default light")
    add_package_option(parser)
    add_set_option(parser, "ROBOT.FIELD=VALUE", "set a field over the scene's; may be repeated")
    parser.add_argument(
        "--replay", type=Path, metavar="REC", help="play a recording instead of the live sources"
    )
    parser.add_argument(
        "--start",
        type=not_negative,
        metavar="S",
        help="where in the recording to begin (default: its first packet)",
    )


class _Package(argparse.Action):
    """Tells this process, and those that it starts, where a package is."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option: Any = None) -> None:
        """Checks and adds one."""
        name, equals, folder = str(values).partition("=")
        if not (name and equals and Path(folder).is_dir()):
            found = f"'{folder}', which is no folder" if equals else f"'{values}'"
            parser.error(f"--package: found {found}; expected NAME=DIR, the package's folder")
        known = os.environ.get(PACKAGES_VARIABLE)
        own = f"{name}={Path(folder).resolve()}"
        os.environ[PACKAGES_VARIABLE] = f"{own}{os.pathsep}{known}" if known else own


class _Argument(argparse.Action):
    """Tells this process, and those that it starts, an argument of xacro."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option: Any = None) -> None:
        """Checks and adds one."""
        name, equals, value = str(values).partition("=")
        if not (name and equals):
            parser.error(f"--arg: found '{values}'; expected NAME=VALUE, an argument of xacro")
        known = json.loads(os.environ.get(ARGUMENTS_VARIABLE) or "{}")
        os.environ[ARGUMENTS_VARIABLE] = json.dumps({**known, name: value})


def add_package_option(parser: argparse.ArgumentParser) -> None:
    """Adds `--package` and `--arg`, for robots from URDF files and xacro."""
    parser.add_argument(
        "--package",
        action=_Package,
        metavar="NAME=DIR",
        help="folder of a ROS package that a URDF names; may be repeated",
    )
    parser.add_argument(
        "--arg",
        action=_Argument,
        metavar="NAME=VALUE",
        help="argument of a robot in xacro, e.g. ur_type=ur5e; may be repeated",
    )


def add_picture_options(parser: argparse.ArgumentParser) -> None:
    """Adds `--size` and `--quality` of pictures and films."""
    parser.add_argument(
        "--size", type=size, default=DEFAULT_SIZE, metavar="WxH", help="pixels (default 1280x800)"
    )
    parser.add_argument(
        "--quality",
        choices=QUALITIES,
        default="normal",
        help="draft: neither shadows nor smooth edges, in a fraction of the time where OpenGL is "
        "software; fine: for print, with 300 dots per inch",
    )


def add_stereo_options(parser: argparse.ArgumentParser) -> None:
    """Adds `--stereo` and `--eye-distance`."""
    parser.add_argument(
        "--stereo",
        choices=STEREO,
        help="for two eyes: a half of the picture for each, or for red-cyan glasses",
    )
    parser.add_argument(
        "--eye-distance",
        type=positive,
        default=EYE_DISTANCE,
        metavar="M",
        help=f"between the eyes, m (default {EYE_DISTANCE}); more shows more depth",
    )


def check_stereo_options(options: argparse.Namespace) -> None:
    """Raises UsageError where `--eye-distance` is given without `--stereo`."""
    if options.stereo is None and options.eye_distance != EYE_DISTANCE:
        raise UsageError("--eye-distance is for --stereo side-by-side or anaglyph; give it as well")


def add_over_options(parser: argparse.ArgumentParser, *, is_live: bool = False) -> None:
    """Adds `--over`, `--camera-file` and `--offset`."""
    if is_live:
        parser.add_argument(
            "--over", metavar="CAMERA",
            help="draw over the pictures of a camera: its number, 0 say, an address, or a video",
        )  # fmt: skip
    else:
        parser.add_argument(
            "--over", type=Path, metavar="FILE",
            help="draw over a photo or a video of the real robot",
        )  # fmt: skip
    parser.add_argument(
        "--camera-file", type=Path, metavar="FILE", help="the camera that took it; YAML or TOML"
    )
    parser.add_argument(
        "--offset",
        type=_offset,
        metavar="S",
        help="time of the recording when the video begins, s since the recording began; auto (the "
        "default) finds it from the motion in both",
    )


def _offset(text: str) -> float | str:
    return text if text == "auto" else _number(text, "s, or auto", lambda value: True)


def check_over_options(options: argparse.Namespace) -> None:
    """Raises UsageError where one of the options of `add_over_options` lacks another."""
    if options.over is not None and options.camera_file is None:
        raise UsageError(
            "--over needs the camera that took it: --camera-file CAMERA.yaml or .toml; "
            "`sero-mj calibrate` writes one"
        )
    for name in ("camera_file", "offset"):
        if getattr(options, name, None) is not None and options.over is None:
            raise UsageError(f"--{name.replace('_', '-')} is for --over; give it as well")


def offset_of_video(scene: Scene, video: Path, camera_file: Path, *, quiet: bool = False) -> float:
    """Finds when in a recording or scenario a video begins, s, and says so unless `quiet`."""
    from rich.console import Console

    from ..viewer.photo.camera_file import read_camera
    from ..viewer.photo.footage import Video
    from ..viewer.photo.video_offset import find_offset

    with Video(video) as opened:
        camera = read_camera(camera_file, opened.size)
    with contextlib.ExitStack() as stack:
        if not quiet:
            console = Console(stderr=True)
            stack.enter_context(console.status("comparing the motion in video and recording"))
        found = find_offset(scene, video, camera)
    if not quiet:
        print(found, flush=True)
    return found.offset


def add_set_option(parser: argparse.ArgumentParser, metavar: str, about: str) -> None:
    """Adds `--set`, for `overrides`."""
    parser.add_argument(
        "--set", action="append", default=[], dest="settings", metavar=metavar, help=about
    )


def overrides(settings: Sequence[str]) -> dict[str, Any]:
    """Reads `--set robot.field=value` options: TOML, or numbers with commas; raises UsageError."""
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


def read_scene(name: str, settings: Sequence[str] = (), *, by_hand: bool = False) -> Scene:
    """Returns the scene that `name` means, see `load_scene`, with what `--set` options say."""
    from ..load import load_scene

    given = overrides(settings)
    with named_settings(given):
        return load_scene(name, given, by_hand=by_hand)


@contextlib.contextmanager
def named_settings(given: Mapping[str, Any], option: str = "--set") -> Iterator[None]:
    """Names the option in problems of what was set by it."""
    try:
        yield
    except DeclarationError as error:
        problems = (_as_set(problem, given, option) for problem in error.problems)
        raise DeclarationError(list(dict.fromkeys(problems))) from None


def _as_set(problem: Problem, given: Mapping[str, Any], option: str) -> Problem:
    """The problem as one of the option, where that is what brought it."""
    for target in given:
        field = target.partition(".")[2]
        # As keys stand in a scene, in a robot's own file, and where there is nothing to set.
        for key in filter(
            None, (rf"\w+\.{re.escape(target)}", re.escape(field), re.escape(target))
        ):
            if found := re.fullmatch(rf"{key}(\..+)?", problem.key):
                return Problem(f"{option} {target}{found[1] or ''}", problem.message)
        # A table on the way to it is wrong as a whole, or unknown.
        inside = problem.key, problem.key.partition(".")[2]
        if any("." in key and target.startswith(f"{key}.") for key in inside):
            return Problem(f"{option} {target}", problem.message)
    return problem


def read_shown_scene(options: argparse.Namespace, *, by_hand: bool = False) -> Scene:
    """The scene that a command with `add_scene_options` names, with what these set.

    Args:
        options: of the command.
        by_hand: see `load_scene`.
    """
    by_hand &= options.replay is None
    scene = read_scene(options.scene, options.settings, by_hand=by_hand)
    if options.look is not None:
        scene.view.look = options.look
    if options.replay is not None:
        replay_instead(scene, options.replay, options.start)
    elif options.start is not None:
        raise UsageError("--start is for recordings; give --replay REC.mcap as well")
    return scene


def replay_instead(scene: Scene, file: Path, start: float | None) -> None:
    """Lets a recording play every source of a scene that it has.

    Args:
        scene: is changed.
        file: the recording.
        start: where to begin, s since the recording began; at its first packet when None.

    Raises:
        RecordingError: it cannot be read.
        UsageError: it has none of the scene's sources, or ends before `start`.
    """
    from ..data.record.recording import Recording
    from ..simulate.runs.run_log import routes_from_recording

    with Recording(file) as recording:
        recorded = {name: list(source.events) for name, source in recording.sources.items()}
        check_span(recording, start)
    both = [name for name in scene.sources if name in recorded]
    if not both:
        found = ", ".join(recorded) or "no source"
        expected = ", ".join(scene.sources) or "none: it has no sources"
        raise UsageError(f"--replay {file} has {found}; scene '{scene.name}' expects {expected}")
    for name in both:
        scene.sources[name] = {"kind": "replay", "file": str(file), "source": name}
        scene.routes = routes_from_recording(scene.routes, name, recorded[name])
        if start is not None:
            scene.sources[name]["start"] = start


def print_json(found: Any) -> None:
    """Prints JSON types; null stands for NaN and infinity, which JSON does not have."""
    print(json.dumps(_finite(found), indent=2))


def _finite(found: Any) -> Any:
    if isinstance(found, Mapping):
        return {key: _finite(value) for key, value in found.items()}
    if isinstance(found, list | tuple):
        return [_finite(value) for value in found]
    if isinstance(found, np.generic):
        found = found.item()
    return None if isinstance(found, float) and not math.isfinite(found) else found


def print_table(table: Table) -> None:
    """Prints a table with all of its numbers, also where the terminal or pipe is narrower."""
    from rich.console import Console

    console = Console()
    endless = console.options.update_width(10_000)
    console.width = max(console.width, console.measure(table, options=endless).maximum)
    console.print(table)


def add_part_options(parser: argparse.ArgumentParser) -> None:
    """Adds `--from`, `--to`, `--scene` and `--source`: what of a recording is looked at."""
    parser.add_argument(
        "--from", type=not_negative, dest="begin", metavar="S", help="from this time on"
    )
    parser.add_argument("--to", type=positive, dest="end", metavar="S", help="up to this time")
    parser.add_argument(
        "--scene",
        metavar="SCENE",
        help="robots and routes, where a recording has none, or of tables (default: what is in it)",
    )
    parser.add_argument("--source", metavar="NAME", help="which source (default: all)")


def check_part(options: argparse.Namespace) -> None:
    """Raises UsageError where `--to` is not after `--from`."""
    if options.begin is not None and options.end is not None and options.end <= options.begin:
        raise UsageError(f"--to: found {options.end:g}; expected more than {options.begin:g} s")


def read_recorded_run(path: Path, source: str | None, scene: Scene | None) -> RunLog:
    """Reads a recording or a table, for a command that can be given the `--scene` it may lack."""
    from ..simulate.runs.run_recording import read_run, read_run_table

    if path.suffix.lower() == ".csv":
        if scene is None:
            raise UsageError(f"{path} does not say what its robots are: give --scene SCENE")
        return read_run_table(path, scene, source)
    try:
        return read_run(path, source, scene=scene)
    except RecordingError as error:
        if scene is None and "give" in error.reason:
            raise RecordingError(error.path, f"{error.reason}: --scene SCENE") from None
        raise


def check_span(recording: Recording, start: float | None, stop: float | None = None) -> None:
    """Raises UsageError for `--start` and `--stop`, s, between which a recording has nothing."""
    from ..data.record.replay import check_start

    if start is not None:
        try:
            check_start(start, recording)
        except ValueError as error:
            raise UsageError(f"--start: {error}") from None
    if start is not None and stop is not None and stop <= start:
        raise UsageError(f"--stop: found {stop:g}; expected more than {start:g}, --start, in s")


@contextlib.contextmanager
def until_ended() -> Iterator[None]:
    """Ends the context, and not the command, with Ctrl-C or SIGTERM (`kill`, `timeout`)."""
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
