"""Measures how often identified parameters are within 1, 2 and 3 standard errors of the truth.

    python benchmarks/identify.py simulate [--runs 200] [--jobs 2]
    python benchmarks/identify.py judge [--links | --commanded] [--resume]
    python benchmarks/identify.py peer

`simulate` writes runs of an independent simulation in plain MuJoCo (see `verdicts/plant.py`) with
random friction, motor inertia, payload, sensor offsets and noise to out/identify. It skips runs
that are already there, so it can be interrupted. `judge` identifies each run and prints the share
of true values within 1, 2 and 3 standard errors, by kind of parameter. With --links, it identifies
all links instead of a payload. With --commanded, it does so without torque sensors. --resume
continues an interrupted measurement. `peer` prepares `identify_peer.py`, which identifies a robot
with Pinocchio and SciPy, and identifies the same robot.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE / "verdicts")]  # the product of this checkout

import mujoco
import numpy as np
from plant import Log, Plant, load_robot

from sero_mj.cli.arguments import read_scene
from sero_mj.extensions.explain.base_parameters import standard_torques
from sero_mj.extensions.explain.identify import figures, identify
from sero_mj.extensions.explain.link_torques import link_torques
from sero_mj.extensions.explain.links.identify_links import identify_links, prediction_errors
from sero_mj.extensions.explain.regression import Estimate
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.simulate.runs.run_log import RunLog

ROBOTS, DURATION = ("lwr", "fr3"), 10.0
OUT = Path("out/identify")
_COMMAND_NOISE = 5e-4  # share of the torque limit, of measured currents without torque sensors
Truth = dict[str, Any]


def make_plant(seed: int) -> tuple[Plant, Truth]:
    """Returns a random plant and its parameters, in the flange frame for the payload."""
    robot = load_robot(ROBOTS[seed % len(ROBOTS)])
    rng = np.random.default_rng([seed, 7])
    plant, n = Plant(robot, rng, duration=DURATION), len(robot.limits)
    plant.viscous = robot.viscous * rng.uniform(0.5, 2.0, n)
    plant.coulomb = robot.coulomb * rng.uniform(0.5, 2.0, n)
    plant.motor_inertias = robot.motor_inertias * rng.uniform(0.7, 1.5, n)
    mass, center = rng.uniform(0.3, 3.0), rng.uniform([-0.06, -0.06, 0.0], [0.06, 0.06, 0.12])
    bias, spread = rng.uniform(-0.01, 0.01, n) * robot.limits, rng.uniform(0.0, 6e-4)

    def load(spec: Any) -> None:
        body = list(spec.joints)[-1].parent.add_body(pos=[0.0, 0.0, robot.flange])
        body.add_geom(size=[0.03], pos=center, mass=mass)

    def biased(log: Log) -> Log:
        noise = rng.normal(0.0, spread, log.torques.shape) * robot.limits
        return log.with_(torques=log.torques + bias + noise)

    plant.edits.append(load)
    plant.sensors.append(biased)
    names = [f"payload.{each}" for each in ("mass", "x", "y", "z")]
    truth = dict(zip(names, (mass, *center), strict=True))
    for key, values in (
        ("coulomb_friction", plant.coulomb),
        ("viscous_friction", plant.viscous),
        ("motor_inertia", plant.motor_inertias),
        ("torque_offset", bias),
    ):
        truth |= {f"{joint}.{key}": value
                  for joint, value in zip(robot.joints, values, strict=True)}  # fmt: skip
    return plant, truth


def simulate(seed: int) -> int:
    """Writes the run of a seed, and the inverse dynamics of its links at random states."""
    file = OUT / f"run{seed}.npz"
    if not file.exists():
        plant, truth = make_plant(seed)
        log = plant.run()
        model = plant._true_model(plant.edits)
        data, rng = mujoco.MjData(model), np.random.default_rng(seed)
        states = rng.normal(0.0, 1.0, (3, 60, model.nv))
        torques = np.empty((60, model.nv))
        for q, v, a, torque in zip(*states, torques, strict=True):
            data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
            mujoco.mj_inverse(model, data)
            torque[:] = data.qfrc_inverse - model.dof_armature * a
        np.savez_compressed(
            file, times=log.times, angles=log.angles, torques=log.torques, commands=log.commands,
            states=states, link_torques=torques, names=list(truth), values=list(truth.values()),
        )  # fmt: skip
    return seed


@cache
def robot_of(name: str) -> SerialRobot:
    robot = read_scene(load_robot(name).scene).robots[name]
    assert isinstance(robot, SerialRobot)
    return robot


def read(seed: int) -> tuple[RunLog, str, Truth]:
    """Returns the run of a seed, its robot and its true parameters."""
    name = ROBOTS[seed % len(ROBOTS)]
    with np.load(OUT / f"run{seed}.npz") as file:
        rows = {key: file[key] for key in ("angles", "torques", "commands")}
        times, truth = file["times"], dict(zip(file["names"], file["values"], strict=True))
    signals = {f"{name}_joint_angles": rows["angles"], f"{name}_torques": rows["torques"],
               f"{name}_commanded_torques": rows["commands"]}  # fmt: skip
    return RunLog({name: robot_of(name)}, signals, times, f"run{seed}"), name, truth


def judge(seed: int) -> list[tuple[str, float]]:
    """Returns kinds of parameters and their errors, in standard errors; NaN if not identifiable."""
    log, name, truth = read(seed)
    found = {key: each for key, (each, _) in figures(identify(log, name)).items()}
    return [(kind_of(key), distance(found[key], value)) for key, value in truth.items()]


def judge_links(seed: int, has_sensors: bool = True) -> list[tuple[str, float]]:
    """Does the same for the identification of all links, without torque sensors if requested."""
    log, name, truth = read(seed)
    robot = log.robots[name]
    if not has_sensors:
        commands = log.signals[f"{name}_commanded_torques"]
        noise = np.random.default_rng(seed).normal(0.0, _COMMAND_NOISE, commands.shape)
        signals = {f"{name}_joint_angles": log.signals[f"{name}_joint_angles"],
                   f"{name}_commanded_torques": commands + noise * robot.torque_bounds}  # fmt: skip
        log = RunLog(log.robots, signals, log.times, log.name)
    whole = identify_links(log, name)
    with np.load(OUT / f"run{seed}.npz") as file:
        states, torques = file["states"], file["link_torques"]
    parameters = {each.name: each for each in whole.parameters}
    for k, joint in enumerate(robot.names):
        offset, inertia = f"{joint}.torque_offset", f"{joint}.motor_inertia"
        if not has_sensors:
            truth[offset] = 0.0
        truth[f"{joint}.drive_offset"] = -truth[offset]
        if inertia not in parameters:  # then it is part of the inertia of the link
            more = truth[inertia] - robot_dynamics(robot).motor_inertias[k]
            torques[:, k] += more * states[2][:, k]
    X = whole.base.columns(standard_torques(robot, *states)).reshape(torques.size, -1)
    links = np.linalg.lstsq(X, torques.ravel(), rcond=None)[0]
    truth |= dict(zip(whole.base.names, links, strict=True))
    rows = []
    for key, (estimate, unit) in whole.named().items():
        kind = parameters[key].kind
        label = f"links, {unit}" if kind == "link" else kind
        rows.append((label, distance(estimate, truth.get(key, 0.0))))
    return rows


def judge_commanded(seed: int) -> list[tuple[str, float]]:
    return judge_links(seed, has_sensors=False)


def judged(task: tuple[str, int, bool]) -> list[tuple[str, float]]:
    """Judges the run of a seed, or reads the stored result."""
    mode, seed, resume = task
    file = OUT / f"{mode}{seed}.json"
    if not (resume and file.exists()):
        judges = {"payload": judge, "links": judge_links, "commanded": judge_commanded}
        file.write_text(json.dumps(judges[mode](seed)), encoding="utf-8")
    return [(kind, size) for kind, size in json.loads(file.read_text("utf-8"))]


def compare_with_peer() -> None:
    """Writes two runs of a Gen3 whose masses differ from its URDF, identifies it, and judges it."""
    robot, runs = load_robot("g3"), []

    def heavier(spec: Any) -> None:
        for k, joint in enumerate(spec.joints):
            share = (1.25, 0.8)[k % 2]
            joint.parent.mass *= share
            joint.parent.fullinertia = np.array(joint.parent.fullinertia) * share

    for seed in (1, 2):
        plant = Plant(robot, np.random.default_rng(seed), duration=DURATION)
        plant.edits.append(heavier)
        log = plant.run()
        log.write(OUT / f"peer{seed}.csv")
        signals = {f"g3_{key}": value for key, value in (
            ("joint_angles", log.angles), ("torques", log.torques),
            ("commanded_torques", log.commands),
        )}  # fmt: skip
        runs.append(RunLog({"g3": robot_of("g3")}, signals, log.times, f"peer{seed}"))
    model = plant._true_model(plant.edits)
    data, states = mujoco.MjData(model), np.random.default_rng(0).normal(size=(3, 200, model.nv))
    torques = np.empty(states.shape[1:])
    for q, v, a, torque in zip(*states, torques, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(model, data)
        torque[:] = data.qfrc_inverse - model.dof_armature * a
    np.savez(OUT / "peer.npz", states=states, torques=torques)
    whole = identify_links(runs[0], "g3")
    left = link_torques(whole.identified, *states) - torques
    print("link torques at random states, rms error:", np.sqrt(np.mean(left**2, axis=0)).round(4))
    for each in prediction_errors(whole, runs[1], "g3"):
        print(each.joint, each.side, f"before {each.before:.4g}, after {each.after:.4g}")
    for name, (estimate, _) in whole.named().items():
        if "friction" in name or "motor_inertia" in name:
            print(name, estimate)


def kind_of(key: str) -> str:
    what = key.rpartition(".")[2]
    return "payload center" if what in "xyz" else "payload mass" if what == "mass" else what


def distance(estimate: Estimate, value: float) -> float:
    if estimate.value is None or not estimate.error:
        return np.nan
    return (estimate.value - value) / estimate.error


def report(rows: Iterable[tuple[str, float]]) -> None:
    by_kind: dict[str, list[float]] = {}
    for kind, size in rows:
        for key in (kind, "all"):
            by_kind.setdefault(key, []).append(size)
    print("| parameter | values | not identifiable | 1 | 2 | 3 standard errors | rms |")
    print("|---|---|---|---|---|---|---|")
    for kind, sizes in by_kind.items():
        known = np.abs([each for each in sizes if np.isfinite(each)])
        shares = " | ".join(f"{100 * np.mean(known < k):.1f} %" for k in (1, 2, 3))
        spread = np.sqrt(np.mean(known**2)) if len(known) else np.nan
        print(f"| {kind} | {len(known)} | {len(sizes) - len(known)} | {shares} | {spread:.2f} |")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("what", choices=("simulate", "judge", "peer"))
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--links", action="store_true")
    parser.add_argument("--commanded", action="store_true")
    parser.add_argument("--resume", action="store_true")
    options = parser.parse_args()
    OUT.mkdir(parents=True, exist_ok=True)
    if options.what == "peer":
        compare_with_peer()
        return 0
    with ProcessPoolExecutor(options.jobs, get_context("spawn")) as pool:
        if options.what == "simulate":
            list(pool.map(simulate, range(options.runs)))
        else:
            mode = "commanded" if options.commanded else "links" if options.links else "payload"
            tasks = [(mode, seed, options.resume) for seed in range(options.runs)]
            report(row for rows in pool.map(judged, tasks) for row in rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
