"""Private parts of MuJoCo: where one is gone, the user is told which, and what would be right."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import mujoco
import pytest

from sero_mj.base.errors import RenderError
from sero_mj.viewer import mujoco_private
from sero_mj.viewer.mujoco_private import PrivateViewer, context_of, page_files, server_program

if sys.platform != "win32":
    from mujoco.studio.web import web_server
    from mujoco.studio.web_viewer import WebViewer


@pytest.mark.gl
def test_a_renderer_has_its_context() -> None:
    with mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 8, 8) as renderer:
        assert isinstance(context_of(renderer), mujoco.MjrContext)


def test_a_renderer_without_a_context_is_told() -> None:
    with pytest.raises(RenderError) as caught:
        context_of(SimpleNamespace())  # type: ignore[arg-type]
    assert str(caught.value) == (
        f"MuJoCo {mujoco.__version__} has no SimpleNamespace._mjr_context, which is needed for "
        "pictures; expected MuJoCo 4.0"
    )


@pytest.mark.parametrize("name", ["_find_static_files_dir", "_run_server"])
def test_a_server_that_lacks_a_part_is_told(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(web_server, name)
    with pytest.raises(RenderError, match=f"web_server.{name}, which is needed for web pages"):
        page_files() if name == "_find_static_files_dir" else server_program(1, 1, None)


def test_the_server_runs_with_other_values_and_is_not_changed() -> None:
    def serve() -> None: ...

    program = server_program(7, 3, serve)
    theirs = web_server._run_server
    assert program.__code__ is theirs.__code__
    assert program.__globals__["serve"] is serve
    assert program.__globals__["_MAX_SPECTATORS_DEFAULT"] == 7
    # Only what Studio's function really reads is replaced.
    assert {"serve", "_STATE_MAX_IN_FLIGHT"} <= {*theirs.__globals__}
    assert theirs.__globals__["serve"] is not serve


def test_studio_reads_what_is_replaced() -> None:
    read = {name for part in _codes(WebViewer) for name in part.co_names}
    wanted = {"_host", "_http_sock", "_start_server", "_tcp_sock", "_headless_ui", "_web_server"}
    assert wanted <= read
    assert {"_host", "_http_sock", "_start_server"} <= {*vars(PrivateViewer)}


def _codes(kind: type) -> list[object]:
    """The compiled methods of a class."""
    return [found.__code__ for found in vars(kind).values() if hasattr(found, "__code__")]


def test_nothing_else_reaches_into_mujoco() -> None:
    import re
    from pathlib import Path

    package = Path(mujoco_private.__file__).parents[1]
    names = re.compile(r"\b(web_server|renderer|web_viewer|mujoco)\._[a-z]\w+|_mjr_context")
    found = [
        f"{path.relative_to(package)}: {hit[0]}"
        for path in package.rglob("*.py")
        if path.name != "mujoco_private.py"
        for hit in names.finditer(path.read_text(encoding="utf-8"))
    ]
    assert found == []
