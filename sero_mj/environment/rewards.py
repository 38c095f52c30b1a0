"""How near is near: rewards from 0 to 1."""

from __future__ import annotations


def closeness(distance: float, within: float, margin: float) -> float:
    """1 up to `within`, then 1 / (1 + 9 ((distance - within) / margin)^2): it never gets flat.

    Args:
        distance: from 0.
        within: up to which it is as good as none, in the same unit.
        margin: that far beyond the reward is 0.1.

    Source: Tunyasuvunakool et al. 2020, dm_control: Software and Tasks for Continuous Control,
    Software Impacts 6 (`tolerance` with a long tail).
    """
    beyond = max(distance - within, 0.0) / margin
    return 1.0 / (1.0 + 9.0 * beyond * beyond)
