"""Whether people with screen readers and weak eyes can use a page: axe-core finds nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from conftest import sampled
from web_tools import MISSING, TORQUES, Served, Visitor

import sero_mj
from sero_mj.load import load_scene
from sero_mj.viewer.player.capture import Mark

pytestmark = pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")

FOUND = """async () => {
    const { violations } = await axe.run(document, { resultTypes: ["violations"] });
    return violations.filter(({ impact }) => impact === "serious" || impact === "critical")
        .map(({ id, nodes }) => `${id}: ${nodes.map(({ html, any }) => html.slice(0, 90)
            + " " + (any[0]?.message ?? "")).join(" | ")}`);
}"""


@pytest.fixture(scope="session")
def axe(node_modules: Path) -> str:
    """The text of axe-core, which is not shipped."""
    return (node_modules / "axe-core" / "axe.min.js").read_text()


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("axe") / "push.html"
    marks = [Mark(0.5, 1.5, "push", "push"), Mark(1.0, 1.0, "it settles", "failed")]
    sero_mj.export_html(load_scene("impedance_push"), path, marks=marks, fps=20, seconds=2.0)
    return path


@pytest.mark.thorough
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", sampled([1280, 390], 1))
def test_axe_finds_nothing_serious(
    browser: Any, axe: str, file: Path, scheme: str, width: int
) -> None:
    context = browser.new_context(
        viewport={"width": width, "height": 844}, color_scheme=scheme, bypass_csp=True
    )
    page = context.new_page()
    page.goto(f"{file.as_uri()}#t=1.5")
    page.locator("html[data-ready]").wait_for(state="attached")
    page.evaluate("player.recording.select({ joint: 1 }); player.draw()")
    page.evaluate(axe)
    assert page.evaluate(FOUND) == []
    page.locator("#help").click()
    assert page.evaluate(FOUND) == []
    context.close()


@pytest.mark.thorough
@pytest.mark.gl
def test_axe_finds_nothing_serious_on_a_live_page(browser: Any, axe: str, tmp_path: Path) -> None:
    settings = (TORQUES, "lwr.show_billboards=true")
    with Served(tmp_path, "lwr", settings=settings, control="joint") as served:
        served.ask("w.actions.perform('plot')")
        for scheme in ("light", "dark"):
            visitor = Visitor(browser, served, (1280, 844), color_scheme=scheme, bypass_csp=True)
            page = visitor.page
            page.locator(".area canvas").first.wait_for()
            page.evaluate(axe)
            assert page.evaluate(FOUND) == [], scheme
            page.locator("#help").click()
            page.locator("dialog[open] .table").first.wait_for()
            assert page.evaluate(FOUND) == [], scheme
            page.keyboard.press("Escape")
            served.until("not w.shows_help")
            visitor.close()
            served.visitors.clear()
