"""Studio's simulation controls and our clock."""

from __future__ import annotations

import socket
import struct
from typing import Any

import pytest
from mujoco.studio import messages, sim
from sero_mj.viewer.web.studio_controls import TimeControl

from sero_mj import Mirror, Scene, SerialRobot, UdpReceiver
from sero_mj.load import load_scene
from sero_mj.viewer.decor.staleness import NO_DATA_YET, Staleness
from sero_mj.viewer.session.clock import Clock


class Handle:
    """What a `TimeControl` needs of Studio's handle."""

    def __init__(self) -> None:
        self.sent: list[Any] = []

    def send_if_changes(self, *make: Any) -> Any:
        return messages.send_if_changes(self.sent.append, *make)


def controlled(mirror: Mirror) -> tuple[TimeControl, Clock, Handle]:
    clock = Clock(mirror)
    control = TimeControl(clock)
    handle = Handle()
    control.handle = handle
    return control, clock, handle


def step_control(*, paused: bool, speed: float) -> messages.StepControlSnapshot:
    control = sim.StepControl()
    control.set_pause_state(sim.PauseState.NORMAL_PAUSED if paused else sim.PauseState.UNPAUSED)
    control.set_speed(speed)
    return messages.StepControlSnapshot.from_step_control(control)


def test_studios_controls_drive_the_clock_of_a_simulation() -> None:
    with Mirror(load_scene("impedance_push")) as mirror:
        control, clock, _ = controlled(mirror)
        step = messages.StepEvent(model=mirror.world.model, data=mirror.data)
        control.on_step_control(step_control(paused=False, speed=50.0))
        assert clock.speed == 0.5
        control.on_step(step)
        assert 0 < mirror.data.time < 1.0
        control.on_step_control(step_control(paused=True, speed=50.0))
        assert clock.is_paused
        before = clock.time
        control.on_single_step(messages.SingleStepEvent())
        assert clock.time == pytest.approx(before + clock.step_size)
        clock.pause()
        control.on_step(step)
        control.on_reset(messages.ResetEvent())
        assert clock.time == 0.0


def test_a_moment_of_the_history_is_gone_on_from() -> None:
    with Mirror(load_scene("impedance_push")) as mirror:
        control, clock, _ = controlled(mirror)
        step = messages.StepEvent(model=mirror.world.model, data=mirror.data)
        clock.seek(2.0)
        clock.advance(0.0)
        control.on_step(step)
        control.on_pause(messages.RequestPauseEvent(pause_state=sim.PauseState.NORMAL_PAUSED))
        control.on_history(None)  # type: ignore[arg-type]
        mirror.data.time = 1.25  # what Studio's history puts there
        control.on_step(step)
        assert clock.time == pytest.approx(1.25, abs=0.05)


@pytest.mark.parametrize("has_come", [True, False])
def test_a_live_robot_that_is_reset_while_paused_is_as_it_came(
    lwr: SerialRobot, has_come: bool
) -> None:
    source = UdpReceiver(structure="7F")
    scene = Scene(robots=[lwr], sources={"udp": source}, routes={"lwr.joint_angles": "udp.values0"})
    with Mirror(scene) as mirror, socket.socket(type=socket.SOCK_DGRAM) as sock:
        if has_come:
            sock.sendto(struct.pack("<7d", *[0.4] * 7), ("127.0.0.1", source.port))
            assert source.wait(5.0)
        clock = Clock(mirror)
        clock.advance(0.1)
        clock.pause()
        clock.reset()
        assert mirror.data.qpos.tolist() == ([0.4] * 7 if has_come else lwr.home.tolist())
        stale = Staleness(mirror.world).find(mirror.data)
        assert stale == ({} if has_come else {"lwr": NO_DATA_YET})
        assert clock.is_paused
