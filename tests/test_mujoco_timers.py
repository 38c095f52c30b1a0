"""MuJoCo without its timers: the same motion, and timers that run again afterwards."""

from __future__ import annotations

import mujoco
import numpy as np

from sero_mj.simulate.mujoco_timers import without_timers

PENDULUM = """
<mujoco><worldbody><body><joint axis="0 1 0"/><geom size="0.1" pos="0 0 -1"/></body></worldbody>
</mujoco>
"""
STEP = int(mujoco.mjtTimer.mjTIMER_STEP)


def stepped() -> tuple[mujoco.MjData, float]:
    """Returns the data after 20 steps and the duration that the timer has measured."""
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    data = mujoco.MjData(model)
    data.qvel[:] = 1.0
    for _ in range(20):
        mujoco.mj_step(model, data)
    return data, data.timer[STEP].duration


def test_timers_are_disabled_only_inside_the_context() -> None:
    timed, duration = stepped()
    assert duration > 0
    with without_timers():
        with without_timers():
            assert stepped()[1] == 0
        data, duration = stepped()
        assert duration == 0
        np.testing.assert_array_equal(data.qpos, timed.qpos)
    assert stepped()[1] > 0
