"""The section Model in a real browser and a real window."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import web_tools
import window_tools
from web_tools import Served, Visitor
from window_tools import Driven, screen

pytestmark = [pytest.mark.gl, pytest.mark.timeout(300)]


def red(pixels: np.ndarray) -> int:
    """Returns the number of pixels that are as red as inertias."""
    r, g, b = np.moveaxis(pixels.astype(int), 2, 0)
    return int(((r > g + 25) & (r > b + 25)).sum())


@pytest.mark.thorough
@pytest.mark.skipif(bool(web_tools.MISSING), reason=f"needs {', '.join(web_tools.MISSING)}")
def test_browser_shows_inertias_inside_transparent_links(browser: Any, tmp_path: Path) -> None:
    with Served(tmp_path, "lwr") as served:
        visitor = Visitor(browser, served, (900, 600))
        page = visitor.page
        page.get_by_text("Model", exact=True).click()
        page.get_by_label("inertias", exact=True).check()
        served.until("w.toggles.inertias")
        visitor.shows(lambda pixels: red(pixels) > 200)
        few = red(visitor.picture())
        page.get_by_label("transparent", exact=True).check()
        visitor.until("player.now.shading.transparent")
        visitor.shows(lambda pixels: red(pixels) > 1.5 * few)
        stands, moves = "surfaces[0][0]", "surfaces[0][1]"
        assert visitor.page.evaluate(
            f"(({{ surfaces }}) => [{stands}.opacity, {moves}.opacity])(player.stage.robots)"
        ) == [1, 0.3]
        page.get_by_label("wireframe", exact=True).check()
        visitor.until("player.stage.robots.surfaces[0].every((each) => each.wireframe)")
        page.locator(".choose", has_text="names").locator("select").select_option("joints")
        page.locator(".label", has_text="lwr/A3").wait_for()
        boxes = page.evaluate(
            "[...document.querySelectorAll('.label')].filter((box) => box.offsetWidth)"
            ".map((box) => box.getBoundingClientRect()).map(({ top, left }) => [top, left])"
        )
        assert len(boxes) == 7
        assert len({tuple(np.round(box)) for box in boxes}) == 7  # each label is readable
        visitor.close()


@pytest.mark.skipif(bool(web_tools.MISSING), reason=f"needs {', '.join(web_tools.MISSING)}")
@pytest.mark.thorough
def test_two_plots_fit_beside_the_image(browser: Any, tmp_path: Path) -> None:
    with Served(tmp_path, "impedance_push") as served:
        visitor = Visitor(browser, served, (1280, 800))
        visitor.page.keyboard.press("p")
        visitor.until("document.querySelectorAll('#areas .graph').length === 2")
        served.until("w.view.size[0] < 1000")
        visitor.until(
            "(({ scrollHeight, clientHeight }) => scrollHeight <= clientHeight)"
            "(document.getElementById('areas'))"
        )
        visitor.close()


@pytest.mark.thorough
@pytest.mark.skipif(bool(window_tools.MISSING), reason=f"needs {', '.join(window_tools.MISSING)}")
def test_window_has_the_same_switches(tmp_path: Path) -> None:
    with screen() as display, Driven(display, tmp_path, "lwr") as window:
        window.key("Tab")
        window.click(*window.middle("Model"))
        for words, name in (("inertias", "inertias"), ("transparent", "transparent")):
            window.click(*window.middle(words))
            window.until(f"w.toggles.{name}")
        # Of the category of decor (4): one box for the base and each link.
        window.until("sum(g.category == 4 and g.type == 6 and g.objtype == 1 "
                     "for g in w.decor._scene.geoms[: w.decor._scene.ngeom]) == 8")  # fmt: skip
        window.until("w.decor._scene.geoms[1].rgba[3] < 0.5")
        window.click(*window.middle("wireframe"))
        window.until("w.decor._scene.flags[2]")
        assert "wireframe=1" in window.ask("w.render_words()")
        window.key("r")
        window.until("not (w.toggles.wireframe or w.toggles.inertias)")
