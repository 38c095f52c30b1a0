"""Counts how often `compare` finds the fault in simulated runs with one fault each.

    .venv/bin/python benchmarks/explain.py [RUNS] [SEED] [pairs]

Poses, motions, joints, sizes, times and sensor noise are random. If the fault changes torques by
less than 0.3 % of the joint's limit, they are drawn again. Every third run has joint torque
control. With `pairs`, each run is compared with the same run without the fault. A run with a fault
is correct if the first explanation of the joint, the flange or the links has the right kind. A run
without a fault is correct if there is no explanation.
"""

from __future__ import annotations

import sys
from collections import Counter, defaultdict
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from sero_mj import Scenario, Scene, SerialRobot, Simulation
from sero_mj.base.errors import SimulationError
from sero_mj.extensions.explain.explain import explain_run, explain_runs
from sero_mj.simulate.runs.run_log import RunLog
from sero_mj.study.explanation import FLANGE, LINKS

KINDS = (
    "none", "sensor sign", "drive sign", "sensor gain", "drive gain", "bias", "delay", "friction",
    "noise", "payload", "stuck joint", "stuck sensor", "masses", "encoder",
)  # fmt: skip
DURATION = 6.0
PAIRS = "pairs" in sys.argv
_SEEN = 0.003  # minimum torque change of a fault as a share of the torque limit


def drawn_run(
    kind: str, rng: np.random.Generator
) -> tuple[RunLog, RunLog | None, str, dict[str, Any]]:
    """Returns a run with a fault, a run without it, the faulty joint, and the parameters.

    The run without the fault, which has other noise, is None unless `PAIRS` is set.
    """
    lwr = SerialRobot.from_model("lwr")
    assert lwr.torque_limits is not None and lwr.position_limits is not None
    bend = np.deg2rad([0, rng.uniform(10, 60), 0, -rng.uniform(40, 80), 0, rng.uniform(20, 70), 0])
    pose = bend + np.deg2rad(rng.uniform(-18, 18, 7))
    lwr = lwr.model_copy(update={"joint_angles": pose})
    k = int(rng.integers(7))
    if kind == "encoder":  # gravity torques depend little on the angles of other joints
        k = int(rng.choice([1, 3]))
    limit, joint = float(lwr.torque_limits[k]), lwr.names[k]
    begin = float(rng.uniform(1.0, 3.0))
    side = rng.choice([-1.0, 1.0])
    gain = float(rng.choice([rng.uniform(0.5, 0.85), rng.uniform(1.15, 1.5)]))
    fault: dict[str, Any] = {"begin": begin, "joints": [joint]}
    fault |= {
        "none": {},
        "sensor sign": {"kind": "sensor", "gain": -1.0},
        "drive sign": {"kind": "controller", "gain": -1.0},
        "sensor gain": {"kind": "sensor", "gain": gain},
        "drive gain": {"kind": "controller", "gain": gain},
        "bias": {"kind": "sensor", "bias": side * limit * rng.uniform(0.005, 0.05)},
        "delay": {"kind": "sensor", "delay_ms": rng.uniform(15.0, 60.0)},
        "friction": {"kind": "friction", "added_coulomb": limit * rng.uniform(0.004, 0.02),
                     "viscous": rng.uniform(1.0, 3.0)},
        "noise": {"kind": "sensor", "noise": limit * rng.uniform(0.003, 0.02)},
        "payload": {},
        "masses": {},
        "stuck joint": {"kind": "friction", "added_coulomb": 1000.0},
        "stuck sensor": {"kind": "frozen_sensor"},
        "encoder": {"kind": "encoder_offset", "offset_deg": side * rng.uniform(0.3, 3.0)},
    }[kind]  # fmt: skip
    load = {"kind": "payload", "robot": "lwr", "mass": rng.uniform(0.5, 5.0), "begin": begin,
            "center_of_mass": rng.uniform([-0.05, -0.05, 0.0], [0.05, 0.05, 0.15])}  # fmt: skip
    motion = rng.choice(["sine", "fast", "chirp", "way_points"])
    size = rng.uniform(5.0, 20.0, 7)
    targets: dict[str, dict[str, Any]] = {
        "sine": {"kind": "sine", "amplitude_deg": size, "frequency": rng.uniform(0.2, 0.5),
                 "phase": rng.uniform(0.0, 6.0, 7)},
        "fast": {"kind": "sine", "amplitude_deg": 0.4 * size, "frequency": rng.uniform(0.6, 1.2),
                 "phase": rng.uniform(0.0, 6.0, 7)},
        "chirp": {"kind": "chirp", "amplitude_deg": 0.7 * size, "start_frequency": 0.2,
                  "end_frequency": rng.uniform(0.6, 1.0), "duration": DURATION},
        "way_points": {"kind": "way_points", "times": [1.5, 3.0, 4.5, 6.0],
                       "way_points": pose + np.deg2rad(rng.uniform(-20, 20, (4, 7)))},
    }  # fmt: skip
    if kind == "encoder" and rng.random() < 0.5:  # a fault from the start
        fault["begin"] = 0.0
    looped = bool(rng.random() < 1 / 3) and kind not in ("friction",)
    noise = 10 ** rng.uniform(-3, -1)
    about = {"joint": joint, "begin": begin, "motion": str(motion), "loop": looped, **fault}
    run: dict[str, Any] = {}
    heavy = lwr
    if kind == "masses":  # only the simulated robot has other masses, not the model
        scale = (1.0 + side * rng.uniform(0.02, 0.2)) * lwr.dynamics.mass_scale
        dynamics = lwr.dynamics.model_copy(update={"mass_scale": scale})
        heavy = lwr.model_copy(update={"dynamics": dynamics})
        about["mass_scale"] = scale
    elif kind == "payload":
        run["disturbances"] = {"load": load}
        about |= load
    elif kind != "none":
        run["faults"] = {"fault": fault}
    always: dict[str, Any] = {
        "controllers": {"lwr": {"kind": "joint_impedance", "stiffness": rng.uniform(300, 2000)}},
        "targets": {"lwr": targets[str(motion)]},
        "sensors": {"lwr": {"angles": {"resolution": 1e-5, "noise": 10 ** rng.uniform(-6.5, -5)},
                            "torques": {"noise": noise, "resolution": 0.01}}},
        "duration": DURATION, "torque_control": looped,
    }  # fmt: skip

    def simulated(robot: SerialRobot, **more: Any) -> RunLog:
        scene = Scene(robots=[robot], floor=False)
        simulation = Simulation(Scenario(scene, **always, seed=int(rng.integers(2**31)), **more))
        with suppress(SimulationError):  # a drive with the wrong sign makes the robot unstable
            for _ in simulation.run():
                pass
        return replace(simulation.log, robots={"lwr": lwr})

    return simulated(heavy, **run), simulated(lwr) if PAIRS else None, joint, about


def named(log: RunLog, other: RunLog | None, joint: str) -> list[str]:
    """Returns the explanations of a run as texts, first those of the joint, flange and links.

    If `other` is not None, the difference between both runs is explained.
    """
    both = "lwr", "lwr"
    explanations = explain_run(log, "lwr") if other is None else explain_runs(log, other, both)
    first = {}
    for each in explanations:
        first.setdefault(each.joint, each)
    words = []
    own = joint, FLANGE, LINKS
    for place in (*own, *(name for name in first if name not in own)):
        if place in first:
            each = first[place]
            part = each.part.rpartition(" ")[2]
            where = "" if place in own else " elsewhere"
            words.append(f"{part} {each.kind}{where}")
    return words


def shows(log: RunLog, kind: str, about: dict[str, Any]) -> bool:
    """Whether a sensor or drive fault changes torques by more than 0.3 % of the limit (rms)."""
    k = log.robots["lwr"].names.index(about["joint"])
    limits = log.robots["lwr"].torque_limits
    rows = log.times > about["begin"]
    if kind.startswith("drive"):
        change = (about["gain"] - 1.0) * log.of("lwr", "commanded_torques")[rows, k]
    elif kind.startswith("sensor") or kind in ("bias", "delay", "stuck sensor"):
        change = (log.of("lwr", "torques") - log.of("lwr", "actual_torques"))[rows, k]
    else:
        return True
    assert limits is not None
    return bool(np.sqrt(np.mean(change**2)) > _SEEN * limits[k])


def is_right(kind: str, words: list[str]) -> bool:
    expected = {
        "bias": "sensor bias", "delay": "sensor delay", "friction": "joint friction",
        "noise": "sensor noise", "payload": "flange payload", "stuck joint": "joint stuck",
        "stuck sensor": "sensor stuck", "masses": "links masses", "encoder": "encoder encoder",
    }.get(kind, kind)  # fmt: skip
    return not words if kind == "none" else bool(words) and words[0] == expected


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    found: dict[str, Counter[str]] = defaultdict(Counter)
    right: Counter[str] = Counter()
    extra: Counter[str] = Counter()
    for kind in KINDS:
        for k in range(count):
            rng = np.random.default_rng([seed, KINDS.index(kind), k])
            log, other, joint, about = drawn_run(kind, rng)
            while not shows(log, kind, about):
                log, other, joint, about = drawn_run(kind, rng)
            words = named(log, other, joint)
            good = is_right(kind, words)
            right[kind] += good
            extra[kind] += len(words) > (kind != "none")
            found[kind][words[0] if words else "none"] += 1
            if not good:
                print(f"  {kind} {k}: {words} {about}", flush=True)
        counts = ", ".join(f"{word} {times}" for word, times in found[kind].most_common())
        print(f"{kind:13} {right[kind]:3d} of {count} correct; {extra[kind]} with additional "
              f"explanations: {counts}", flush=True)  # fmt: skip
    print(f"{100.0 * right.total() / (count * len(KINDS)):.1f} % correct")


if __name__ == "__main__":
    main()
