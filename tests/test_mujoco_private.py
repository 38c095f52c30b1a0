"""Private parts of MuJoCo: an error names the missing part and the expected version."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import mujoco
import pytest

from sero_mj.base.errors import RenderError
from sero_mj.viewer.image import mujoco_private
from sero_mj.viewer.image.mujoco_private import context_of, filament


@pytest.mark.gl
def test_renderer_has_its_context() -> None:
    with mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 8, 8) as renderer:
        assert isinstance(context_of(renderer), mujoco.MjrContext)


def test_missing_context_is_reported() -> None:
    with pytest.raises(RenderError) as caught:
        context_of(SimpleNamespace())  # type: ignore[arg-type]
    assert str(caught.value) == (
        f"MuJoCo {mujoco.__version__} has no SimpleNamespace._mjr_context, which is needed for "
        "images; expected MuJoCo 4.0"
    )


def test_filament_and_its_materials_are_found() -> None:
    module = filament()
    assert {"Context", "ModelRenderables", "ModelResources", "Material"} <= {*dir(module)}


def test_missing_filament_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(mujoco, "mjrf", raising=False)
    monkeypatch.setitem(sys.modules, "mujoco.mjrf", None)
    with pytest.raises(RenderError, match=r"has no Filament renderer .*; expected MuJoCo 4\.0"):
        filament()


def test_no_other_module_uses_private_parts_of_mujoco() -> None:
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
