"""Opens files that are dropped on a viewer or typed on the start page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self, TypeVar

from ..base import paths
from ..base.errors import SeroError, UsageError, without_warnings
from ..data.record.csv_files import is_table
from .arguments import network_scene, note_choice, read_scene, replay_instead
from .shared_options import is_recording

if TYPE_CHECKING:  # `render` asks only whether a file is a recording
    from ..viewer.session.recent_views import RecentView


class _ShowsScene(Protocol):
    """Options of a command that shows a scene or a recording."""

    scene: Any
    replay: Path | None
    source: str | None

    def model_copy(self, *, update: Any = None) -> Self: ...


T = TypeVar("T", bound=_ShowsScene)


def view_of_file(path: Path, shown: str | None, source: str | None = None) -> RecentView:
    """Returns the view that shows a file.

    A recording is shown by the scene that is shown already, if it mirrors the recorded sources;
    else by the scene of the recording's name: one that was viewed lately, is beside the recording
    or shipped, or at last by what the recording has of it.

    Args:
        path: of a robot, a scene, a scenario or a recording.
        shown: name or file of the scene that is shown; None for none.
        source: of the recording, that moves the robot.

    Raises:
        SeroError: there is no such file, or nothing shows the recording.
    """
    from ..viewer.session.recent_views import RecentView

    if not is_recording(path):
        return RecentView(str(path.resolve()))
    if not path.exists():
        raise UsageError(f"{path}: no such file")
    why: list[SeroError] = []
    for scene in _scenes_of(path, shown, source):
        try:
            with without_warnings():
                replay_instead(read_scene(scene, replay=path), path, None, source)
        except SeroError as error:
            if paths.is_temporary(scene):
                text = str(error).replace(f"{Path(scene).parent}/", "")
                hint = f"show it by the scene's own file and --replay {path.name}"
                error = UsageError(f"{path.name}: of its scene, {text}; {hint}")
            why.append(error)
        else:
            return RecentView(scene, str(path.resolve()))
    if why:
        raise why[0]
    raise UsageError(
        f"{path.name}: found no scene that shows it; sero-mj view SCENE --replay {path.name} "
        "shows it by one"
    )


def with_scene(options: T) -> T:
    """Returns the options of what shows a scene, where that is something else, with its own scene.

    That is a recording, or a network, `ros2://`.
    """
    if options.scene is not None and (found := network_scene(str(options.scene))) is not None:
        return options.model_copy(update={"scene": found})
    if options.scene is None or not is_recording(options.scene):
        return options
    if options.replay is not None:
        raise UsageError(f"--replay: {options.scene} is a recording already")
    recording = Path(options.scene)
    if is_table(recording) and recording.exists():
        raise UsageError(
            f"{recording} is a table, which does not say what its robot is; give the robot or its "
            f"scene, and --replay {recording}"
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
    """Whether a view's files end with this process, as those dropped on a page do."""
    return any(paths.is_temporary(name) for name in view)
