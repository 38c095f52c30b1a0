"""Files and live pages in Firefox."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from firefox import MISSING, Firefox
from web_tools import Served

import sero_mj

pytestmark = [
    pytest.mark.gl,
    pytest.mark.live,
    pytest.mark.slow,
    pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}"),
]


@pytest.fixture(scope="module")
def firefox() -> Iterator[Firefox]:
    with Firefox() as firefox:
        yield firefox


@pytest.mark.thorough
def test_exported_file_plays_with_the_values_of_the_run(firefox: Firefox, tmp_path: Path) -> None:
    scene = sero_mj.load_scene("impedance_push")
    sero_mj.export_html(scene, tmp_path / "run.html", seconds=2.0, fps=10)
    firefox.goto(f"{(tmp_path / 'run.html').as_uri()}#t=1")
    log = scene.sources["simulation"].run.log
    frames = [0, 4, 9, 15, 20]
    rows = [int(np.argmin(np.abs(log.times - frame / 10))) for frame in frames]
    found = firefox.evaluate(
        f"{frames}.map(f => [0, 1, 2, 3, 4, 5, 6].map(j =>"
        " player.run.values.torques[j * player.run.frames + f]))"
    )
    assert np.array_equal(found, log.of("lwr", "torques")[rows])
    assert 0 < firefox.evaluate("player.calls") <= 20
    firefox.click(".card")
    firefox.until("document.querySelector('#details h2')?.textContent.startsWith('lwr/')")
    firefox.press("h")
    firefox.until("document.getElementById('helptext').open")
    firefox.press("h")
    firefox.click("#timeline button")
    firefox.until("player.recording.clock.isPlaying")
    before = firefox.evaluate("player.recording.clock.at")
    firefox.until(f"player.recording.clock.at !== {before}")
    assert firefox.faults == []


@pytest.mark.thorough
def test_live_page_shows_data_and_accepts_clicks_and_keys(firefox: Firefox, tmp_path: Path) -> None:
    with Served(tmp_path, "impedance_push") as served:
        firefox.goto(served.url)
        firefox.until("player.state && player.isInControl && !player.view.isDirty")
        size = "[player.stage.size.width, player.stage.size.height]"
        served.until(f"[*w.view.size] == {firefox.evaluate(size)}")
        begin = firefox.evaluate("player.state.run.begin")
        firefox.until(f"player.state.run.begin > {begin} + 0.2")
        is_on = served.ask("bool(w.toggles.arrows.any())")
        firefox.press("a")
        served.until(f"bool(w.toggles.arrows.any()) != {is_on}")
        served.until("w.view.of_data(w.data) is not None")
        x, y = firefox.evaluate(
            "(({ x, y }, { left, top }) => [x + left, y + top])"
            "(player.stage.pixel(player.stage.centre(1)),"
            " document.getElementById('picture').getBoundingClientRect())"
        )
        firefox.click_at(x, y)
        served.until("[*clicks]")
        assert served.ask("clicks[0][1]").startswith("lwr/")
        assert firefox.evaluate("player.calls") <= 20 and firefox.faults == []
    firefox.until("document.getElementById('problem').textContent.includes('is not running')")


@pytest.mark.thorough
def test_billboards_have_their_sizes_and_marks_are_on_the_timeline(
    firefox: Firefox, tmp_path: Path
) -> None:
    sizes = "[...document.querySelectorAll('.card')].map((e) => [e.offsetWidth, e.offsetHeight])"
    are_short = "player.now.cards.every(({ lines }) => lines.length === 1)"
    with Served(tmp_path, "impedance_push") as served:
        firefox.goto(served.url)
        firefox.until("player.state && player.isInControl && document.querySelector('.card')")
        served.ask("w.actions.perform('pause')")
        firefox.until(f"{are_short} && !player.view.isDirty")
        before = firefox.evaluate(sizes)
        served.ask("w.toggles.details.__setitem__(slice(None), True)")
        firefox.until(f"!({are_short}) && !player.view.isDirty")
        assert firefox.evaluate(sizes) != before
        served.ask("w.toggles.details.__setitem__(slice(None), False)")
        firefox.until(f"{are_short} && !player.view.isDirty")
        assert firefox.evaluate(sizes) == before
        served.ask("w.actions.perform('mark')")
        firefox.until("document.querySelector('#timeline .ticks .mark')")
        place = "document.querySelector('#timeline {}').getBoundingClientRect()"
        share = "(({ value, min, max }) => (value - min) / (max - min))"
        tick = firefox.evaluate(f"{place.format('.ticks .mark')}.left + 1.5")
        rail = firefox.evaluate(place.format(".track input"))
        at = firefox.evaluate(f"{share}(document.querySelector('#timeline .track input'))")
        assert tick == pytest.approx(rail["left"] + 7 + at * (rail["width"] - 14), abs=2)
