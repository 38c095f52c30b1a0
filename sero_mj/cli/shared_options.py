"""Options that several commands share. The declarations of commands inherit from these classes."""

from __future__ import annotations

import json
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, model_validator

from ..base import paths
from ..base.declaration import expecting
from ..base.errors import UsageError, did_you_mean
from ..base.options import Duration, Option, Options, Time, ending, positional, whole
from ..base.plugins import BACKGROUNDS, ENGINES, load_first, load_plugin, plugins
from ..data.record.csv_files import TABLE_ENDINGS, is_table, parse_columns
from ..robots.importers.package_files import ARGUMENTS_VARIABLE, PACKAGES_VARIABLE
from ..study.figure import NO_MATPLOTLIB, SUFFIXES, has_matplotlib
from ..viewer.image.image_options import EYE_DISTANCE, CameraOptions, StereoOptions
from .arguments import read_recorded_run, read_scene, replay_instead

if TYPE_CHECKING:
    from ..data.drive.mirror import Mirror
    from ..robots.declared.scene import Scene
    from ..simulate.runs.run_log import RunLog
    from ..study.engine import Engine
    from ..viewer.window.viewport import Viewport


def _drawn(path: Path | None) -> Path | None:
    if path is not None and not has_matplotlib():
        raise ValueError(NO_MATPLOTLIB)
    return path


File = Annotated[Path, Option("FILE")]
Recording = Annotated[Path, Option("REC")]
Figure = Annotated[Path, ending(*SUFFIXES), AfterValidator(_drawn), Option("OUT")]
Settings = Annotated[list[str], Option("KEY=VALUE", ("--set",))]
Flag = Annotated[str | None, Option("NAME")]


def _columns(text: str) -> str:
    parse_columns([text])  # raises ValueError
    return text


Columns = Annotated[list[Annotated[str, AfterValidator(_columns)]], Option("SIGNAL=COLUMNS")]
Count = Annotated[int, whole(1, 200_000), Option("N")]
_LOCAL = "local"


def is_recording(path: Path | str) -> bool:
    """Whether a file or folder is a recording (MCAP or ROS bag) or a table, without reading it."""
    if str(path).lower().endswith((".mcap", ".bag", ".bag.active", ".db3", *TABLE_ENDINGS)):
        return True
    return bool(str(path)) and (
        Path(path, "metadata.yaml").is_file() or bool(paths.bag_files_in(path))
    )


class SceneArgument(Options):
    """The positional argument of commands that need a scene.

    Attributes:
        scene: file or included name of a scene or robot.
    """

    scene: Annotated[str, positional("SCENE")]


class JsonOptions(Options):
    """Options of commands that print JSON.

    Attributes:
        as_json: print JSON.
    """

    as_json: Annotated[bool, Option(flags=("--json",))] = False


def _package(text: str) -> str:
    name, equals, folder = text.partition("=")
    if not (name and equals and Path(folder).is_dir()):
        found = f"'{folder}', which is not a folder" if equals else f"'{text}'"
        raise ValueError(f"found {found}; expected NAME=DIR with the folder of the package")
    return text


def _argument(text: str) -> str:
    if text.find("=") < 1:
        raise ValueError(f"found '{text}'; expected NAME=VALUE for a xacro argument")
    return text


class PackageOptions(Options):
    """Options for robots in URDF and xacro.

    Attributes:
        package: name and folder of a ROS package that a URDF file uses; repeatable.
        arg: xacro argument, for example ur_type=ur5e; repeatable.
    """

    package: Annotated[list[Annotated[str, AfterValidator(_package)]], Option("NAME=DIR")] = []
    arg: Annotated[list[Annotated[str, AfterValidator(_argument)]], Option("NAME=VALUE")] = []

    def apply(self) -> None:
        """Passes the options to importers, also in child processes, by environment variables."""
        for name, _, folder in (text.partition("=") for text in self.package):
            known = os.environ.get(PACKAGES_VARIABLE)
            own = f"{name}={Path(folder).resolve()}"
            os.environ[PACKAGES_VARIABLE] = f"{own}{os.pathsep}{known}" if known else own
        if self.arg:
            arguments = json.loads(os.environ.get(ARGUMENTS_VARIABLE) or "{}")
            arguments |= dict(text.split("=", 1) for text in self.arg)
            os.environ[ARGUMENTS_VARIABLE] = json.dumps(arguments)


class SettingOptions(PackageOptions):
    """Options that override fields of a scene.

    Attributes:
        settings: override a field of the scene; repeatable.
    """

    settings: Annotated[Settings, Option("ROBOT.FIELD=VALUE", ("--set",))] = []


class ReplayOptions(Options):
    """Options for replaying a recording instead of live sources.

    Attributes:
        replay: play a recording or a table (.csv) instead of the live sources.
        start: start time in the recording, in seconds (default: the first packet).
        source: source that moves the robot, if a ROS recording has several sources.
        columns: columns of a table, e.g. "joint_angles=q_*" or time=stamp; repeatable.
    """

    replay: Recording | None = None
    start: Time | None = None
    source: Flag = None
    columns: Columns = []

    @model_validator(mode="after")
    def _check_start(self) -> Self:
        is_played = self.replay is not None or is_recording(vars(self).get("scene") or "")
        if self.start is not None and not is_played:
            raise ValueError("--start needs a recording: add --replay REC.mcap")
        if self.source is not None and not is_played:
            raise ValueError("--source needs a recording: add --replay REC.mcap")
        if self.columns and (self.replay is None or not is_table(self.replay)):
            raise ValueError("--columns needs a table: add --replay TABLE.csv")
        return self

    def read_replayed(self, name: str, settings: Sequence[str] = (), **how: bool) -> Scene:
        """Loads a scene; with --replay, the recording replaces the sources of the scene.

        `how` contains further options of `load_scene`.
        """
        scene = read_scene(name, settings, replay=self.replay, **how)
        if self.replay is not None:
            replay_instead(scene, self.replay, self.start, self.source, self.columns)
        return scene


class ShownOptions(CameraOptions, SettingOptions, ReplayOptions):
    """Options of commands that show a scene.

    Attributes:
        look: color scheme that overrides the color scheme of the scene (default: light).
    """

    look: Literal["light", "dark"] | None = None

    def read(self, name: str, *, by_hand: bool = False, trusted: bool = False) -> Scene:
        """Loads a scene and applies these options; the flags are those of `load_scene`."""
        by_hand = by_hand and self.replay is None
        scene = self.read_replayed(name, self.settings, by_hand=by_hand, trusted=trusted)
        if self.look is not None:
            scene.view.look = self.look
        if self.follow is not None:
            if (problem := scene.follow_problem("--follow", self.follow)) is not None:
                raise UsageError(problem)
            scene.view.follow = self.follow
        return scene

    def from_its_begin(self) -> Self:
        """Returns options with --start 0, so that a replay starts when the recording began."""
        return self if self.replay is None else self.model_copy(update={"start": 0.0})


class EyeOptions(StereoOptions):
    """Options for stereo images."""

    @model_validator(mode="after")
    def _check_eyes(self) -> Self:
        if self.stereo is None and self.eye_distance != EYE_DISTANCE:
            raise ValueError("--eye-distance needs --stereo side-by-side or anaglyph")
        return self


class OverOptions(Options):
    """Options for drawing a scene over a photo or video.

    Attributes:
        over: draw over a photo or video of the real robot.
        camera_file: file with the camera calibration of the photo or video, YAML or TOML.
        offset: time in the recording at which the video begins, in seconds; auto estimates
            this time from the motion (default: auto).
    """

    title: ClassVar[str] = "drawing over photos and videos"
    over: Annotated[str | None, Option("FILE")] = None
    camera_file: File | None = None
    offset: Annotated[float | Literal["auto"] | None, expecting("s, or auto"), Option("S")] = None

    @model_validator(mode="after")
    def _check_over(self) -> Self:
        if self.over is None:
            self.refuse(("camera_file", "offset"), " needs --over FILE")
        elif self.camera_file is None:
            raise ValueError(
                "--over needs --camera-file CAMERA.yaml or .toml. `sero-mj calibrate` writes one."
            )
        return self


class RunOptions(Options):
    """Options for reading recordings of robots.

    Attributes:
        scene: scene with the robots and routes, for files that contain none: tables, and some
            recordings (default: the scene in the recording).
        source: source to read (default: all sources).
        columns: columns of a table, e.g. "joint_angles=q_*" or time=stamp; repeatable.
    """

    scene: str | None = None
    source: Flag = None
    columns: Columns = []

    @cached_property
    def _declared(self) -> Scene | None:
        return None if self.scene is None else read_scene(self.scene)

    def files(self) -> list[Path]:
        """Returns the files of the scene, including its robots and meshes."""
        scene = self._declared
        if scene is None:
            return []
        return [*scene.files(), *(mesh for _, mesh in scene.meshes())]

    def read(self, path: Path, source: str | None) -> RunLog:
        """Reads one source of a recording or a table; `source` is None for all sources."""
        robots = vars(self).get("robot") or ()
        names = robots.split(",") if isinstance(robots, str) else robots
        return read_recorded_run(path, source, self._declared, names, self.columns)


class EngineOptions(Options):
    """Options for parallel execution.

    Attributes:
        jobs: number of processes (default: one per core).
        engine: `local`, or the name of a cluster engine from `sero-mj list` (default: local).
        scheduler: scheduler of the cluster: tcp://HOST:PORT, the scheduler's .json file, or a .toml
            file with a dask-jobqueue table such as [slurm].
        ship: additional file or folder to send to the workers; repeatable.
    """

    jobs: Annotated[Count | None, Option("J")] = None
    engine: Annotated[str, Option("NAME")] = "local"
    scheduler: Annotated[str | None, Option("ADDRESS")] = None
    ship: Annotated[list[Path], Option("PATH")] = []

    @model_validator(mode="after")
    def _check_engine(self) -> Self:
        if self.engine == _LOCAL:
            if self.scheduler is not None or self.ship:
                option = "--ship" if self.scheduler is None else "--scheduler"
                known = " or ".join(plugins(ENGINES)) or "NAME"
                raise ValueError(f"{option} needs --engine {known}")
        elif self.engine not in plugins(ENGINES):
            names = [_LOCAL, *plugins(ENGINES)]
            raise ValueError(f"--engine: found {self.engine}{did_you_mean(self.engine, names)}")
        elif self.scheduler is None:
            expected = "expected --scheduler, for example tcp://HOST:PORT"
            raise ValueError(f"--engine {self.engine}: {expected}")
        elif self.jobs is not None:
            raise ValueError(f"--jobs cannot be combined with --engine {self.engine}")
        return self

    def make_engine(self) -> Engine:
        """Returns the engine that these options select."""
        if self.engine == _LOCAL:
            from ..study.engine import Processes, available_cpus

            return Processes(self.jobs or available_cpus())
        engine: Engine = load_plugin(ENGINES, self.engine)(self.scheduler, self.ship)
        return engine


class PartOptions(RunOptions):
    """Options for the time range of recordings.

    Attributes:
        begin: start time in seconds (default: the first packet).
        end: end time in seconds (default: the last packet).
    """

    begin: Annotated[Time | None, Option("S", ("--from",))] = None
    end: Annotated[Duration | None, Option("S", ("--to",))] = None

    @model_validator(mode="after")
    def _check_part(self) -> Self:
        if self.begin is not None and self.end is not None and self.end <= self.begin:
            raise ValueError(f"--to: found {self.end:g}; expected more than {self.begin:g} s")
        return self

    def read_part(self, path: Path) -> RunLog:
        """Reads the selected source and time range of a recording or a table."""
        log = self.read(path, self.source)
        is_whole = self.begin is None and self.end is None
        return log if is_whole else log.between(self.begin, self.end)


class Background(ABC):
    """An extension, created without arguments, that draws scenes over photos and videos."""

    @abstractmethod
    def render(self, options: Options, over: Path) -> list[str]:
        """Renders a scene over the photo or video `over`.

        Returns the names of the sources from which no valid packet arrived.
        """

    @abstractmethod
    def viewport(
        self, mirror: Mirror, options: OverOptions
    ) -> AbstractContextManager[Callable[..., Viewport]]:
        """Opens a camera or video; yields a function that creates a viewport for its images."""


def find_background() -> Background:
    """Returns the installed background; raises UsageError if there is none."""
    found: Background | None = load_first(BACKGROUNDS, Background)
    if found is None:
        raise UsageError("--over needs an extension that can draw over photos and videos")
    return found
