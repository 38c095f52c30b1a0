"""Records what the sources of a scene receive, as they receive it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..assemble.scene import Scene
from ..receive.source import Source
from ..record.recorder import SIGNALS_RATE, Recorder
from .route import wire
from .signal_names import RoutedSignals
from .wiring import Route


@contextmanager
def record_sources(
    sources: Mapping[str, Source],
    path: Path | str,
    *,
    scene: Scene | None = None,
    overwrite: bool = False,
    signals_rate: float = SIGNALS_RATE,
) -> Iterator[Recorder]:
    """Records every packet that the sources receive while the context lasts.

    Args:
        sources: by name, `mirror.sources` say; opened or not. Replays are not recorded again.
        path: where to, OUT.mcap.
        scene: its file and those of its robots are kept in the recording, and its routes say what
            the decoded values are called there: `lwr.A1.torque [Nm]`.
        overwrite: write over a file that exists.
        signals_rate: of how many packets per second and source the decoded values are kept as well.

    Raises:
        RecordingError: the file exists already or cannot be written; at the end, too, when the
            disk became full. What was written before is kept and can be read.
    """
    about = {"sero-mj": __version__, "scene": "" if scene is None else scene.name}
    with Recorder(path, about=about, overwrite=overwrite, signals_rate=signals_rate) as recorder:
        recorded = []
        routes = [] if scene is None else wire(scene).routes
        try:
            for name, source in sources.items():
                if source.is_live:
                    _add(recorder, name, source, scene, routes)
                    recorded.append(source)
            for file in [] if scene is None else _files_of(scene):
                recorder.attach(
                    f"{file.parent.name}/{file.name}", "application/toml", file.read_bytes()
                )
            yield recorder
        finally:
            for source in recorded:
                source.record_to(None)


def _add(
    recorder: Recorder, name: str, source: Source, scene: Scene | None, routes: list[Route]
) -> None:
    routed = None if scene is None else RoutedSignals(scene, routes, name, source.events)

    def decode(packet: bytes) -> Mapping[str, NDArray[np.float64]] | None:
        values = source.decode(packet)
        return values if values is None or routed is None else routed.of(values)

    recorder.add_source(
        name,
        kind=source.kind,
        declared=source.decoding_fields(),
        events=source.events,
        size=source.size,
        decode=decode,
        signals=None if routed is None else routed.signals,
    )

    def tap(
        rows: NDArray[np.uint8], lengths: NDArray[np.intp], arrivals: NDArray[np.float64]
    ) -> None:
        recorder.take(name, rows, arrivals, np.minimum(lengths, rows.shape[1]))

    source.record_to(tap)


def _files_of(scene: Scene) -> list[Path]:
    models = [robot._model for robot in scene.robots.values()]
    files = [scene.file, *models]
    return [file for file in dict.fromkeys(files) if file is not None and file.is_file()]
