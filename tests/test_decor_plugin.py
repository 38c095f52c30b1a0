"""A visual feature of a third-party package is found by its entry point and drawn like ours."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from decor_tools import GEOM, of_kind, view_at
from plugin_tools import install

from sero_mj import DeclarationError, Scene, SerialRobot, World, load_scene
from sero_mj.base.plugins import forget_plugins
from sero_mj.viewer.decor import feature
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.toggles import Toggles

GROUP = "sero_mj.decor"


@pytest.fixture
def world() -> World:
    robot = SerialRobot.from_model("lwr", inputs=["temperatures"])
    return World(Scene(robots=[robot], floor=False))


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    forget_plugins()
    install(tmp_path, "temperature_gauge", GROUP, "temperature", "TemperatureGauge")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    forget_plugins()
    sys.modules.pop("temperature_gauge", None)


def test_gauge_is_drawn_at_each_joint_with_a_temperature(installed: Path, world: World) -> None:
    data, decor = world.make_data(), Decor(world)
    world.set_input(data, "lwr.temperatures", [20.0, 40.0, 79.0, np.nan, 0.0, 80.0, 500.0])
    buffer = decor.draw(data, Toggles(world), view_at())
    boxes = of_kind(buffer.rows[: buffer.count], GEOM.mjGEOM_BOX)
    assert len(boxes) == 6 * 12
    filled = (boxes["rgba"][:, 3] == 1.0).reshape(6, 12).sum(axis=1)
    assert filled.tolist() == [3, 6, 12, 0, 12, 12]
    ring = boxes["pos"].reshape(6, 12, 3).mean(axis=1)
    centres = data.site_xpos[world.joints.centre_site[[0, 1, 2, 4, 5, 6]]]
    np.testing.assert_allclose(ring, centres, atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(boxes["mat"].astype(float)), 1.0, atol=1e-6)
    axes = data.site_xmat[world.joints.centre_site[0]].reshape(3, 3)
    np.testing.assert_allclose(boxes["mat"][:12, :, 2], np.tile(axes[:, 2], (12, 1)), atol=1e-6)


def test_scene_has_settings_of_its_features(installed: Path, tmp_path: Path) -> None:
    file = tmp_path / "warm.toml"

    def scene(text: str) -> Scene:
        file.write_text(f'floor = false\n[robots.lwr]\nmodel = "lwr"\n{text}')
        return load_scene(file)

    warm = World(scene('inputs = ["temperatures"]\n[decor.temperature]\nfull = 40.0'))
    data, decor = warm.make_data(), Decor(warm)
    warm.set_input(data, "lwr.temperatures", [20.0, *[np.nan] * 6])
    buffer = decor.draw(data, Toggles(warm), view_at())
    boxes = of_kind(buffer.rows[: buffer.count], GEOM.mjGEOM_BOX)
    assert (boxes["rgba"][:, 3] == 1.0).sum() == 6
    hidden = Decor(
        World(scene("[decor.temperature]\nshow = false\n[decor.selection]\nshow = false"))
    )
    assert len(hidden.features) == len(decor.features) - 2
    for text, key in (
        ("[decor.temperature]\nfull = -1", "decor.temperature.full"),
        ("[decor.selection]\nful = 1", "decor.selection.ful"),
        ("[decor.temperatur]\nfull = 1", "decor.temperatur"),
    ):
        with pytest.raises(DeclarationError) as error:
            scene(text)
        assert [problem.key for problem in error.value.problems] == [key]


def test_feature_settings_can_be_overridden_and_are_checked(
    installed: Path, tmp_path: Path
) -> None:
    file = tmp_path / "warm.toml"
    file.write_text('[robots.lwr]\nmodel = "lwr"\n')
    assert load_scene(file, {"decor.temperature.full": 40.0}).decor == {
        "temperature": {"full": 40.0}
    }
    with pytest.raises(DeclarationError) as error:
        load_scene(file, {"decor.temperature.ful": 40.0})
    assert [problem.key for problem in error.value.problems] == ["decor.temperature.ful"]
    module = installed / "temperature_gauge.py"
    start = (
        "    def start(self):\n"
        "        from sero_mj.base.errors import Problem\n"
        "        raise Problem('full', found=self.settings.full, expected='a colder one').error()\n"
    )
    text = module.read_text()
    module.write_text(text.replace("    def draw(", f"{start}\n    def draw(", 1))
    sys.modules.pop("temperature_gauge", None)
    forget_plugins()
    with pytest.raises(DeclarationError) as error:
        Decor(World(load_scene(file)))
    (problem,) = error.value.problems
    assert problem.key == "decor.temperature.full" and problem.found == 80.0


@pytest.mark.slow
def test_plugin_feature_is_listed_with_its_package(installed: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "sero_mj", "list"],
        env={**os.environ, "PYTHONPATH": str(installed)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "temperature_gauge:TemperatureGauge from temperature-gauge" in done.stdout
    assert "round_arrows       sero_mj.viewer.decor.round_arrows:RoundArrows\n" in done.stdout


def test_feature_that_cannot_be_imported_is_reported_and_skipped(
    installed: Path, world: World, caplog: pytest.LogCaptureFixture
) -> None:
    (installed / "temperature_gauge.py").write_text("import no_such_module\n")
    with caplog.at_level(logging.WARNING):
        decor = Decor(world)
    assert len(decor.features) == len(Decor(world).features) >= 8
    assert (
        "sero_mj.decor: 'temperature' of temperature-gauge 0.1 "
        "(temperature_gauge:TemperatureGauge) cannot be loaded: "
        "ModuleNotFoundError: No module named 'no_such_module'; skipped"
    ) in caplog.text


def test_feature_that_fails_while_drawing_is_disabled(
    installed: Path, world: World, caplog: pytest.LogCaptureFixture
) -> None:
    (installed / "temperature_gauge.py").write_text(
        "from sero_mj.viewer.decor.feature import Feature\n"
        "class TemperatureGauge(Feature):\n"
        "    def draw(self, frame):\n"
        "        raise ZeroDivisionError('cold')\n"
    )
    decor, data, toggles = Decor(world), world.make_data(), Toggles(world)
    toggles.axes[:] = True
    for _ in range(3):
        assert decor.draw(data, toggles, view_at()).count > 20
    assert caplog.text.count("is disabled") == 1
    assert all(type(each).__module__ != "temperature_gauge" for each in decor.features)


def test_features_are_drawn_in_declared_order(world: World) -> None:
    orders = [each.order for each in feature.make_features(world)]
    assert orders == sorted(orders) and len(orders) >= 8
