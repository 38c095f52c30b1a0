"""Rate, jitter and delay are the same for single packets and for batches."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from sero_mj.data.receive.tracking import Timing

_GAPS = st.floats(0.0, 0.1) | st.sampled_from([0.0, 1.9, 2.1, 11.0])


@settings(max_examples=examples(100), deadline=None)
@given(
    st.lists(st.tuples(_GAPS, _GAPS), max_size=40),
    st.booleans(),
    st.integers(1, 40),
)
def test_timing_of_single_packets_equals_that_of_a_batch(
    gaps: list[tuple[float, float]], stamped: bool, first: int
) -> None:
    begin = [(100.0, 5.0), (0.01, 0.01)]  # which are the reference
    arrivals, stamps = np.cumsum(np.array([*begin, *gaps]), axis=0).T
    one, many = Timing(), Timing()
    for each in (one, many):
        each.add(arrivals[:2], stamps[:2] if stamped else None)
    for k in range(2, len(arrivals)):
        one.add(arrivals[k : k + 1], stamps[k : k + 1] if stamped else None)
    # Without time stamps, jitter is relative to the mean of the previous batch.
    if stamped and len(arrivals) > 2:
        for part in (slice(2, 2 + first), slice(2 + first, None)):
            if len(arrivals[part]):
                many.add(arrivals[part], stamps[part])
        if np.ptp(arrivals) < 10.0:  # the baseline is updated once per batch
            assert one.delay == pytest.approx(many.delay, abs=1e-9)
        assert one.jitter == pytest.approx(many.jitter, abs=1e-9)
        assert one.interval == pytest.approx(many.interval, abs=1e-9)
    assert math.isfinite(one.jitter) and one.interval >= 0.0


@pytest.mark.realtime
def test_steady_sender_at_1_khz_has_no_jitter_and_no_delay() -> None:
    timing = Timing()
    for k in range(100):
        timing.add(np.array([k * 1e-3 + 0.002]), np.array([k * 1e-3]))
    assert timing.rate == pytest.approx(1000.0)
    assert timing.jitter == pytest.approx(0.0, abs=1e-9)
    assert timing.delay == pytest.approx(0.0, abs=1e-9)
    assert timing.fastest == pytest.approx(0.002)
    timing.add(np.array([0.105]), np.array([0.100]))
    assert timing.delay == pytest.approx(0.003)
    assert timing.jitter == pytest.approx(0.003 / 16)
