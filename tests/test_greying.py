"""Robots without fresh data on the page: models in other colours, fetched beforehand."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from sero_mj.viewer.web.studio_decor import Greying, greyed

from sero_mj import World
from sero_mj.load import load_scene
from sero_mj.viewer.decor.geom_buffer import GREY


def test_greyed_models_differ_in_colour_only() -> None:
    world = World(load_scene("lwr"))
    model = world.model
    grey = np.zeros(model.ngeom, bool)
    grey[-1] = True
    other = greyed(model, grey)
    assert (other.geom_rgba[:-1, 3] == 1).any()
    assert np.abs(other.geom_rgba[-1, :3] - GREY).max() < 0.2
    assert other.nq == model.nq
    np.testing.assert_array_equal(other.geom_pos, model.geom_pos)
    # What is not grey has the colour that it had: of its material, where it has one.
    floor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, "floor")
    np.testing.assert_array_equal(other.geom_rgba[floor], model.mat_rgba[model.geom_matid[floor]])
    rest = np.delete(np.arange(model.ngeom - 1), floor)
    np.testing.assert_array_equal(other.geom_rgba[rest], model.geom_rgba[rest])


class FakeServer:
    """Keeps models as Studio's server does."""

    def __init__(self) -> None:
        self.models: dict[int, bytes] = {}

    def add_model(self, bundle: bytes) -> None:
        import zlib

        self.models[zlib.crc32(bundle)] = bundle

    def cached_model(self, crc32: int) -> bytes | None:
        return self.models.get(crc32)


class FakeViewer:
    """What `Greying` needs of a viewer."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model, self.server = model, FakeServer()
        self.changes: list[int] = []

    def change_model(self, bundle: bytes, crc32: int) -> None:
        assert self.server.models[crc32] == bundle
        self.changes.append(crc32)


def test_browsers_have_time_to_fetch_a_model_and_flapping_changes_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = [100.0]
    monkeypatch.setattr("sero_mj.viewer.web.studio_decor.time.monotonic", lambda: now[0])
    model = World(load_scene("lwr")).model
    viewer = FakeViewer(model)
    greying = Greying(viewer)  # type: ignore[arg-type]
    grey = np.ones(model.ngeom, bool)
    greying.show(None)
    for _ in range(20):  # to and fro, faster than a browser fetches
        now[0] += 0.05
        greying.show(grey)
        greying.show(None)
    assert len(viewer.changes) == 0
    greying.show(grey)
    now[0] += 1.1
    greying.show(grey)
    assert len(viewer.changes) == 1
    greying.show(None)
    assert len(viewer.changes) == 1
    now[0] += 1.1
    greying.show(None)
    assert len(viewer.changes) == 2
    assert len(set(viewer.changes)) == 2


def test_what_is_grey_from_the_start_is_at_once() -> None:
    model = World(load_scene("lwr")).model
    viewer = FakeViewer(model)
    Greying(viewer).show(np.ones(model.ngeom, bool))  # type: ignore[arg-type]
    assert len(viewer.changes) == 1
