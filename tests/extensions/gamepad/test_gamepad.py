"""A gamepad: what its sticks and buttons change in a window, and unplugging it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from window_tools import MISSING, Driven, screen

from sero_mj.extensions.gamepad.gamepad import BUTTONS, PAD_KEYS, PAD_STICKS, deflection
from sero_mj.viewer.image.clicks import KEYS
from sero_mj.viewer.session.keys import MORE_KEYS, VIEWER_KEYS
from sero_mj.viewer.session.tool import tool_keys

REST = (0.0, 0.0, 0.0, 0.0, -1.0, -1.0)
SET = ("lwr.joint_angles=0,0.6,0,-1.2,0,0.8,0",)


def test_sticks_have_a_dead_zone_and_fine_control_near_it() -> None:
    ways = np.linspace(-1, 1, 201)
    meant = deflection(ways)
    assert (meant[np.abs(ways) <= 0.15] == 0).all()
    assert meant[[0, -1]].tolist() == [-1, 1]
    assert (np.diff(meant) >= 0).all()
    assert np.abs(np.diff(meant)).max() < 0.03  # without a step at the edge of the dead zone
    assert deflection(np.array([0.3]))[0] < 0.05


def test_every_button_presses_an_existing_key_and_is_in_the_help() -> None:
    assert set(PAD_KEYS) <= set(BUTTONS)
    assert {key for key, _ in PAD_KEYS.values()} <= {*KEYS, *VIEWER_KEYS, *MORE_KEYS, *tool_keys()}
    assert not set(PAD_KEYS) & {"left stick"}  # selects what the sticks move
    assert all(PAD_STICKS.values())


@pytest.fixture(scope="module")
def window(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Driven]:
    with screen() as display, Driven(
        display, tmp_path_factory.mktemp("pad"), "lwr", settings=SET
    ) as opened:  # fmt: skip
        opened.ask("globals().update(PadState=__import__('sero_mj.extensions.gamepad.gamepad', "
                   "fromlist=['PadState']).PadState)")  # fmt: skip
        yield opened


def use(window: Driven, *buttons: str, axes: tuple[float, ...] = REST) -> None:
    """Holds buttons and sticks from now on."""
    down = tuple(name in buttons for name in BUTTONS)
    window.ask(f"setattr(w.tools['gamepad'], 'read', lambda: PadState('Pad', {down}, {axes}))")
    window.settle()


@pytest.mark.gl
@pytest.mark.live
@pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")
@pytest.mark.thorough
def test_sticks_move_view_and_robot_and_buttons_press_keys(window: Driven) -> None:
    use(window)
    assert window.ask("w.notice.text").startswith("Pad: the sticks rotate and pan the view")
    position = "w.decor.view.position.tolist()"
    start, right = np.array(window.ask(position)), np.array(window.ask("w.decor.view.right"))
    use(window, axes=(1.0, *REST[1:]))
    window.until(f"np.abs(np.array({position}) - {start.tolist()}).max() > 0.05")
    use(window)
    # To the right of its previous position.
    assert (np.array(window.ask(position)) - start) @ right > 0
    distance = window.ask("w.navigator.camera.distance")
    use(window, axes=(*REST[:5], 1.0))
    window.until(f"w.navigator.camera.distance < {0.9 * distance}")
    use(window)
    start = np.array(window.ask(position))
    use(window, axes=(0.0, 0.0, 0.0, -1.0, -1.0, -1.0))
    window.until(f"np.array({position})[2] > {start[2]} + 0.03")  # up
    use(window, "RB")
    use(window, "RB")
    assert window.ask("w.toggles.selected") == 1  # once, regardless of how long it is held
    use(window, "X")
    window.until("w.toggles.arrows.all()")

    flange = "w.world.frame(w.data, 'lwr/flange')[:3, 3].tolist()"
    use(window, "left stick")
    assert window.ask("w.notice.text") == "gamepad: the sticks move lwr"
    start, camera = np.array(window.ask(flange)), window.ask(position)
    use(window, axes=(0.0, -1.0, *REST[2:]))
    window.until(f"np.array({flange})[2] > {start[2]} + 0.02")
    use(window)
    window.settle()
    way, up = np.array(window.ask(flange)) - start, np.array(window.ask("w.decor.view.up"))
    assert np.abs(way - (way @ up) * up).max() < 0.01  # straight up in the image
    assert window.ask(position) == pytest.approx(camera)
    use(window, "left stick")
    assert window.ask("w.notice.text") == "gamepad: the sticks move the view"

    window.ask("setattr(w.tools['gamepad'], 'read', lambda: None)")
    window.settle()
    assert window.ask("w.notice.text") == "Pad is disconnected"
