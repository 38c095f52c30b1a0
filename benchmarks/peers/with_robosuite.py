"""robosuite's controllers of a Panda's seven joints: one step, its update of the model included."""

from __future__ import annotations

import numpy as np
import robosuite
from common import best, main, tell
from robosuite.controllers import load_composite_controller_config, load_part_controller_config

NAME = "robosuite"


def step_of(kind: str) -> None:
    config = load_composite_controller_config(controller="BASIC")
    part = load_part_controller_config(default_controller=kind)
    config["body_parts"]["right"] |= part
    environment = robosuite.make(
        "Lift",
        robots="Panda",
        controller_configs=config,
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
    )
    environment.reset()
    controller = environment.robots[0].part_controllers["right"]
    controller.set_goal(np.full(controller.control_dim, 0.01))

    def call() -> None:
        controller.update(force=True)
        controller.run_controller()

    call()
    tell(NAME, best(call, 50, 20))


if __name__ == "__main__":
    main({
        "joint_control": lambda: step_of("JOINT_POSITION"),
        "cartesian_control": lambda: step_of("OSC_POSE"),
    })  # fmt: skip
