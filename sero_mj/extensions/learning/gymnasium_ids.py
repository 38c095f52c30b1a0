"""The environments under their names for `gymnasium.make`.

Gymnasium (1.4) looks for no packages by itself. So they are registered as soon as both it and
sero_mj have been imported, in either order; see `base.when_imported`.
"""

from __future__ import annotations

from ...base.paths import list_models, list_scenarios

NAMESPACE = "sero_mj"
TASKS = ("reach", "hold")  # those of `make.TASKS`, which takes MuJoCo to import
_ONE = "sero_mj.extensions.learning.gymnasium_env:make_gymnasium_environment"
_MANY = "sero_mj.extensions.learning.gymnasium_vector:make_gymnasium_vector"


def register_environments() -> None:
    """Registers all environments with gymnasium.

    `sero_mj/ROBOT-TASK-v0` for shipped robots (`sero_mj/lwr-reach-v0`), `sero_mj/TASK-v0` for any
    robot (`robot="panda"`, a folder or a file), `sero_mj/SCENARIO-v0` for shipped scenarios, and
    `sero_mj/scenario-v0` for any (`scenario="my.toml"`). What is registered already stays. Robots
    with a task are stepped together in `gymnasium.make_vec`, scenarios one by one.

    Raises:
        ImportError: gymnasium is not installed.
    """
    from gymnasium.envs.registration import register, registry

    kinds = {
        f"{robot}-{task}": {"name": f"{robot}/{task}"} for robot in list_models() for task in TASKS
    }
    kinds |= {task: {"task": task} for task in TASKS}
    kinds |= {scenario: {"name": scenario} for scenario in list_scenarios()}
    kinds |= {"scenario": {}}
    for name, options in kinds.items():
        if f"{NAMESPACE}/{name}-v0" not in registry:
            register(
                id=f"{NAMESPACE}/{name}-v0",
                entry_point=_ONE,
                vector_entry_point=_MANY if name.endswith(TASKS) else None,
                kwargs=options,
            )
