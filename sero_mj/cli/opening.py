"""Selects the scene that shows a file or address.

The file or address comes from the command line, the start page, or drag and drop.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self, TypeVar

from ..base import paths
from ..base.errors import SeroError, UsageError, without_warnings
from ..data.record.csv_files import is_table
from .arguments import network_scene, note_choice, read_scene, replay_instead
from .shared_options import is_recording

if TYPE_CHECKING:
    from ..viewer.session.recent_views import RecentView


class _ShowsScene(Protocol):
    scene: Any
    replay: Path | None
    source: str | None

    def model_copy(self, *, update: Any = None) -> Self: ...


T = TypeVar("T", bound=_ShowsScene)


def view_of_file(path: Path, shown: str | None, source: str | None = None) -> RecentView:
    """Returns the view that shows a robot, scene, scenario or recording.

    A recording is shown in the scene `shown` if this scene has the recorded sources. Otherwise,
    it is shown in a scene with the recorded name: a recent scene, a scene in the same folder, an
    included scene, or the scene that is stored in the recording. `source` selects the source of a
    ROS recording.

    Raises:
        SeroError: the file does not exist, or no scene shows the recording.
    """
    from ..viewer.session.recent_views import RecentView

    if not is_recording(path):
        return RecentView(str(path.resolve()))
    if not path.exists():
        raise UsageError(f"{path}: no such file")
    errors: list[SeroError] = []
    for scene in _scenes_of(path, shown, source):
        try:
            with without_warnings():
                replay_instead(read_scene(scene, replay=path), path, None, source)
        except SeroError as error:
            if paths.is_temporary(scene):
                text = str(error).replace(f"{Path(scene).parent}/", "")
                hint = f"use the file of the scene and --replay {path.name}"
                error = UsageError(f"{path.name}: in the recorded scene: {text}; {hint}")
            errors.append(error)
        else:
            return RecentView(scene, str(path.resolve()))
    if errors:
        raise errors[0]
    raise UsageError(
        f"found no scene that has the sources of {path.name}. "
        f"Choose one: sero-mj view SCENE --replay {path.name}"
    )


def with_scene(options: T) -> T:
    """Returns the options with a scene instead of a recording or an address such as `ros2://`."""
    if options.scene is not None and (found := network_scene(str(options.scene))) is not None:
        return options.model_copy(update={"scene": found})
    if options.scene is None or not is_recording(options.scene):
        return options
    if options.replay is not None:
        raise UsageError(f"--replay: {options.scene} is already a recording")
    recording = Path(options.scene)
    if is_table(recording) and recording.exists():
        raise UsageError(
            f"{recording} is a table, which does not describe its robot. Name the robot or its "
            f"scene, and add --replay {recording}."
        )
    view = view_of_file(recording, None, options.source)
    note_choice(recording, view.scene)
    shown = {"scene": view.scene, "replay": recording}
    return options.model_copy(update=shown)


def _scenes_of(path: Path, shown: str | None, source: str | None) -> Iterator[str]:
    from ..data.record.formats import open_recording
    from ..data.record.scene_files import write_scene

    if shown is not None:
        yield shown
    if is_table(path):
        return
    with open_recording(path) as recording:
        if recording.names_joints:
            yield from recording.scenes(f"sero-mj view NAME --replay {path}", source)
            return
        name = recording.about.get("scene", "")
    if not name:
        return
    from ..viewer.session.recent_views import recent_views

    for view in recent_views():
        if Path(view.scene).stem == name:
            yield view.scene
    if (beside := path.parent / f"{name}.toml").is_file():
        yield str(beside)
    if paths.shipped_file(name) is not None:
        yield name
    with open_recording(path) as recording:
        own = write_scene(recording, name, paths.make_temporary_folder())
    if own is not None:
        yield str(own)


def is_temporary(view: RecentView) -> bool:
    """Whether a view uses temporary files, such as files that were dropped on a page."""
    return any(paths.is_temporary(name) for name in view)
