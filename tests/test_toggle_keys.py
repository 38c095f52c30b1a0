"""Messages about a key that has switched something."""

from __future__ import annotations

import numpy as np
import pytest

from sero_mj import Double, Scene, SerialRobot, World
from sero_mj.viewer.decor.toggles import Toggles
from sero_mj.viewer.image.clicks import KEYS, press_toggle


@pytest.fixture(scope="module")
def world() -> World:
    return World(
        Scene(
            robots=[SerialRobot.from_model("lwr", show_arrows=True)],
            doubles=[Double(name="goal", of="lwr")],
        )
    )


def test_message_describes_what_is_shown_now(world: World) -> None:
    toggles, data = Toggles(world), world.make_data()
    world.set_input(data, "lwr.torques", np.full(7, 5.0))

    def press(key: str) -> str:
        return press_toggle(key, world, data, toggles)

    assert press("a") == "arrows: off"
    assert press("q") == "arrows: torque error (they are off: a)"
    assert press("a") == "arrows: torque error (no data)"  # nothing was commanded
    world.set_input(data, "lwr.commanded_torques", np.full(7, 6.0))
    toggles.arrow_quantity[:3] = 0
    assert press("l") == "legend: off"
    assert press("a") == "arrows: off"
    assert press("a") == "arrows: torque, torque error"
    assert press("b") == "billboards: on"
    assert press("d") == "transparent doubles: off"
    assert press("v") == "no smart arrows in this scene"
    assert press("r") == "reset to the declared values"
    assert toggles.arrows[:7].all()
    assert toggles.doubles.all()
    assert not toggles.billboards.any()


def test_every_key_has_a_message_in_an_empty_scene() -> None:
    world = World(Scene())
    for key in KEYS:
        said = press_toggle(key, world, world.make_data(), Toggles(world))
        assert said, key
    assert press_toggle("q", world, world.make_data(), Toggles(world)) == "no arrows in this scene"
