"""Functions that the tests of foxglove and zenoh share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_bytes import joint_state

from sero_mj.base.errors import DeclarationError
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.drive.record_sources import record_sources
from sero_mj.data.receive.source import Source, make_source
from sero_mj.data.record.recording import Recording
from sero_mj.data.record.replay import Replay
from sero_mj.load import load_scene


def assert_refused(kind: str, fields: dict[str, Any], key: str, reason: str) -> None:
    """Asserts that a source with invalid fields is rejected with this reason."""
    with pytest.raises(DeclarationError) as caught:
        make_source("driver", {"kind": kind, **fields})
    (problem,) = caught.value.problems
    assert problem.key == key
    assert problem.message.startswith(reason)


def mirrored_recorded_and_replayed(
    text: str, folder: Path, wait: Callable[[], bool], send: Callable[[Any, bytes], None]
) -> Source:
    """Checks that a recording shows the same values as its scene; `send` sends two packets."""
    file, recording = folder / "arm.toml", folder / "arm.mcap"
    file.write_text(text)
    scene = load_scene(file)

    def check(mirror: Mirror) -> None:
        world = mirror.world
        angles = mirror.data.qpos[world.robots["arm"].qpos]
        np.testing.assert_array_equal(angles, [1.0, 0.5, 0.25])
        torques = mirror.data.userdata[world.slots["arm.torques"]]
        np.testing.assert_array_equal(torques, [7.0, 8.0, 9.0])

    with Mirror(scene) as mirror:
        source: Any = mirror.sources["driver"]
        mirror.advance()  # while nothing listens
        assert wait()
        with record_sources(mirror.sources, recording, scene=scene):
            send(source, joint_state(["c", "b", "a"], [0.25, 0.5, 1.0], [], [9.0, 8.0, 7.0]))
        mirror.advance()
        check(mirror)
    with Recording(recording) as written:
        assert len([*written.packets("driver")]) == 2
    scene.sources["driver"] = Replay(name="driver", file=recording)
    with Mirror(scene) as again:
        again.advance(1e3)
        check(again)
        return again.sources["driver"].original
