"""Detection of restarted senders with another port, and of concurrent senders."""

from __future__ import annotations

import numpy as np
import pytest

from sero_mj.data.receive.intake import Intake
from sero_mj.data.receive.structure import Structure

LAYOUT = Structure("n:1I t:1d")
EVERY = 0.005  # s


def sent_by(
    port: int, count: int, start: float, clock: float = 0.0
) -> list[tuple[float, int, bytes]]:
    """Returns the packets of one run of a sender: arrival, port, bytes."""
    return [
        (
            start + EVERY * k,
            port,
            LAYOUT.encode({"n": np.array([k]), "t": np.array([clock + EVERY * k])}),
        )
        for k in range(count)
    ]


def taken(packets: list[tuple[float, int, bytes]], batch: int, **fields: str) -> Intake:
    """Returns an intake that has received the packets in order of arrival, in batches."""
    intake = Intake(LAYOUT, **fields)
    packets = sorted(packets)
    for first in range(0, len(packets), batch):
        part = packets[first : first + batch]
        rows = np.array([np.frombuffer(packet, np.uint8) for _, _, packet in part])
        senders = np.array([[port >> 8, port & 255] for _, port, _ in part], np.uint8)
        lengths = np.full(len(part), LAYOUT.size)
        intake.take(rows, lengths, np.array([arrival for arrival, _, _ in part]), senders)
        intake.count()
    return intake


@pytest.mark.slow
@pytest.mark.parametrize("batch", [1, 7, 256])
@pytest.mark.parametrize("pause", [0.02, 0.3, 3.0])
@pytest.mark.parametrize("fields", [{}, {"sequence": "n"}, {"sequence": "n", "time": "t"}])
def test_restarted_sender_with_a_new_port_counts_as_a_restart(
    batch: int, pause: float, fields: dict[str, str]
) -> None:
    run = 300 * EVERY
    clocks = (0.0, 500.0, 7.0)  # three runs with different clocks
    packets = [
        packet
        for k, clock in enumerate(clocks)
        for packet in sent_by(4000 + k, 300, 10.0 + k * (run + pause), clock)
    ]
    intake = taken(packets, batch, **fields)
    counters = intake.counters
    assert (counters.restarts, counters.senders) == (2, 1)
    assert (counters.lost, counters.late, counters.duplicates) == (0, 0, 0)
    assert intake.timing.delay == pytest.approx(0.0, abs=1e-9)  # on the new clock


@pytest.mark.parametrize("batch", [1, 7, 256])
def test_alternating_senders_are_concurrent_without_restarts(batch: int) -> None:
    packets = [*sent_by(4000, 400, 10.0), *sent_by(4001, 300, 10.502)]
    counters = taken(packets, batch, sequence="n").counters
    assert (counters.restarts, counters.senders, counters.lost) == (0, 2, 0)


def test_remaining_sender_is_the_only_sender() -> None:
    packets = [*sent_by(4000, 400, 10.0), *sent_by(4001, 1200, 10.502)]
    counters = taken(packets, 7, sequence="n").counters
    assert (counters.restarts, counters.senders) == (0, 1)


def test_pause_of_a_sender_is_not_a_restart() -> None:
    packets = [*sent_by(4000, 10, 10.0), *sent_by(4000, 10, 20.0)]
    assert taken(packets, 7).counters.restarts == 0


def test_sender_with_a_new_port_for_each_packet_does_not_restart() -> None:
    packets = [
        (arrival, 4000 + k, packet) for k, (arrival, _, packet) in enumerate(sent_by(0, 900, 10.0))
    ]
    intake = taken(packets, 7, time="t")
    assert (intake.counters.restarts, intake.counters.senders) == (0, 1)
    assert intake.timing.rate == pytest.approx(200.0)


def test_sender_that_returns_to_its_first_port_restarts_again() -> None:
    ports = (4000, 4001, 4000)
    packets = [p for k, port in enumerate(ports) for p in sent_by(port, 300, 10.0 + 5.0 * k)]
    counters = taken(packets, 1, sequence="n").counters
    assert (counters.restarts, counters.senders) == (2, 1)
