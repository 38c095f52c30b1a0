"""Earlier public names work and warn, for one version."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import pytest

import sero_mj
from sero_mj.cli import translated
from sero_mj.simulate.control.controller import ControllerDeclaration
from sero_mj.viewer.session.tool import Tool


@pytest.mark.parametrize(
    ("old", "new"), [("render_film", "render_video"), ("render_picture", "render_image")]
)
def test_earlier_function_is_the_current_one(old: str, new: str) -> None:
    with pytest.warns(DeprecationWarning, match=new):
        assert getattr(sero_mj, old) is getattr(sero_mj, new)


def test_earlier_option_is_the_current_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert translated(["view", "lwr", "--finish-films"]) == ["view", "lwr", "--finish-videos"]
    assert "--finish-videos" in capsys.readouterr().err


def test_earlier_method_of_a_tool_is_called_by_its_current_name() -> None:
    with pytest.warns(DeprecationWarning, match="receive"):

        class Listener(Tool):
            def hear(self, message: Any) -> str:
                return f"heard {message}"

    assert Listener.receive is Listener.hear
    assert Tool.receive is not Listener.receive


def test_earlier_attribute_of_a_controller_sets_the_current_one() -> None:
    with pytest.warns(DeprecationWarning, match="may_be_probed"):

        class Remote(ControllerDeclaration):
            kind: Literal["remote"] = "remote"
            may_be_asked: ClassVar[bool] = False

            def make(self, model: Any, timestep: float) -> Any: ...

    assert not Remote.may_be_probed and ControllerDeclaration.may_be_probed
