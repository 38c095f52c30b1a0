"""Registers the environments for `gymnasium.make`.

Gymnasium (1.4) does not search for packages. Therefore, the environments are registered as soon as
both Gymnasium and sero_mj are imported, in any order; see `base.when_imported`.
"""

from __future__ import annotations

from ...base.paths import list_models, list_scenarios

NAMESPACE = "sero_mj"
TASKS = ("reach", "hold")  # the keys of `make.TASKS`, without importing MuJoCo
_ONE = "sero_mj.extensions.learning.gymnasium_env:make_gymnasium_environment"
_MANY = "sero_mj.extensions.learning.gymnasium_vector:make_gymnasium_vector"


def register_environments() -> None:
    """Registers all environments that are not yet registered with Gymnasium.

    The names are `sero_mj/ROBOT-TASK-v0` for included robots (`sero_mj/lwr-reach-v0`),
    `sero_mj/TASK-v0` for any robot (`robot="panda"`, a folder or a file), `sero_mj/SCENARIO-v0` for
    included scenarios, and `sero_mj/scenario-v0` for any scenario (`scenario="my.toml"`).
    `gymnasium.make_vec` steps robots with a task together, and scenarios one by one.
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
