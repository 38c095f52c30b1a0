"""Precomputed packets equal the packets computed on time, with their counters and time stamps."""

from __future__ import annotations

import time

import numpy as np
import pytest

from sero_mj.data.receive.structure import Structure
from sero_mj.data.send.play import MotionPackets
from sero_mj.data.send.sender import PacketBuffer, paced, send
from sero_mj.load import load_scene

PARABOLA = Structure("n:1H t:1I at:1d v:2f tag:1B=7 bits:1I")


def parabola(t: float) -> bytes:
    return PARABOLA.encode({"v": [t, 2 * t], "at": [t * t], "bits": [round(t * 1000)]})


class Kept:
    """Stores packets and their arrival times."""

    def __init__(self) -> None:
        self.packets: list[bytes] = []
        self.times: list[float] = []

    def put(self, packet: bytes) -> None:
        self.times.append(time.perf_counter())
        self.packets.append(packet)


def test_every_packet_is_computed_up_to_1_khz() -> None:
    ahead = PacketBuffer(parabola, PARABOLA, rate=1000)
    assert [ahead.at(k / 1000) for k in range(50)] == [parabola(k / 1000) for k in range(50)]


def test_values_are_interpolated_between_computed_packets_above_1_khz() -> None:
    ahead = PacketBuffer(parabola, PARABOLA, rate=4000)
    packets = [PARABOLA.decode(ahead.at(k / 4000)) for k in range(9)]
    np.testing.assert_allclose(
        [p["at"][0] for p in packets], np.interp(np.arange(9) / 4, [0, 1, 2], [0, 1e-6, 4e-6])
    )
    np.testing.assert_allclose([p["v"][1] for p in packets], np.arange(9) / 2000, rtol=1e-6)
    # Integers and constants come from the previous computed packet.
    assert [p["bits"][0] for p in packets] == [0] * 4 + [1] * 4 + [2]
    assert {p["tag"][0] for p in packets} == {7.0}


@pytest.mark.realtime
@pytest.mark.thorough
@pytest.mark.slow
def test_packets_are_numbered_and_stamped_and_counters_wrap() -> None:
    ahead = PacketBuffer(parabola, PARABOLA, rate=100, sequence="n", time="t", time_scale=1e-6)
    packets = [PARABOLA.decode(ahead.at(k / 100)) for k in range(65_540)]
    assert [p["n"][0] for p in packets[:3]] == [1, 2, 3]
    assert [p["n"][0] for p in packets[65_533:65_537]] == [65_534, 65_535, 0, 1]
    assert [p["t"][0] for p in packets[:3]] == [0, 10_000, 20_000]


def test_buffer_can_skip_packets() -> None:
    ahead = PacketBuffer(parabola, PARABOLA, rate=1000)
    assert ahead.at(0.2) == parabola(0.2)
    assert ahead.at(0.2) == parabola(0.2)
    assert ahead.at(0.7) == parabola(0.7)


@pytest.mark.slow
def test_idle_time_fills_the_buffer_up_to_its_limit() -> None:
    made: list[float] = []

    def slow(t: float) -> bytes:
        made.append(t)
        time.sleep(0.002)
        return parabola(t)

    ahead = PacketBuffer(slow, PARABOLA, rate=1000)
    ahead.at(0.0)
    assert not ahead.idle(0.001)
    assert ahead.idle(0.1)
    assert made == [0.0, 0.001]
    while ahead.idle(1.0):
        pass
    assert len(made) == 251  # at most a quarter of a second early


@pytest.mark.realtime
@pytest.mark.slow
@pytest.mark.parametrize("rate", [1000, 5000, 10_000])
def test_lwr_motion_is_sent_at_the_requested_rate(rate: int) -> None:
    packets = MotionPackets(load_scene("lwr_udp"))
    for _ in range(3):  # a busy machine may stall one run
        ahead, kept = PacketBuffer(packets.at, packets.structure, rate=rate), Kept()
        report = send(paced(ahead.at, rate, 0.5), kept, idle=ahead.idle)
        assert len(set(kept.packets)) == report.packets == rate // 2
        late = np.array(kept.times) - kept.times[0] - np.arange(rate // 2) / rate
        if abs(report.rate / rate - 1) < 0.02 and np.median(late) < 1e-3:
            break
    else:
        pytest.fail(f"{report}")
    angles = [packets.structure.decode(p)["values0"] for p in kept.packets[:: rate // 10]]
    computed = [packets.structure.decode(packets.at(k / 10))["values0"] for k in range(5)]
    np.testing.assert_allclose(angles, computed, atol=1e-9)
