"""Every shipped scenario notices what an engineer may get wrong in it.

A table of mutations: gains, loads, friction, sensors, limits, motions and pushes that are not what
they should be. Something that a scenario expects has to fail in each of them. `make test` tries the
first two of every scenario, which are subtle ones; CI tries eight, and `make mutations` all.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from conftest import examples

from sero_mj.base.errors import SimulationError
from sero_mj.base.paths import find_scenario, list_scenarios
from sero_mj.simulate.control.compiler import Compiler
from sero_mj.simulate.expect import Expect
from sero_mj.simulate.scenario import Scenario
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation

# Dotted keys with their values, as `--set` takes them; or tables that are added to the file.
Mutation = dict[str, Any] | str

LEAST = 8
# Of every scenario: in a test of every day, in a thorough one; all in that of `make mutations`.
TRIED = {25: 2, 100: LEAST}.get(examples(100))
SLOW = ("biped_stand", "hit_hand_grasp", "justin_push")
GAINS = "controllers.lwr"
OFF = {"kind": "torque", "compensate_gravity": False}


def fault(kind: str, **keys: Any) -> str:
    """A fault from the beginning on."""
    lines = [f"{key} = {value!r}" for key, value in keys.items()]
    return "\n".join(["[faults.mutation]", f"kind = '{kind}'", *lines, ""])


def load(mass: float, robot: str = "lwr") -> str:
    """A load (kg) at the flange that the controller does not know of."""
    return f"[disturbances.mutation]\nkind = 'payload'\nrobot = '{robot}'\nmass = {mass}\n"


def worn(robot: str = "lwr") -> str:
    """Ten times the friction."""
    return fault("friction", robot=robot, viscous=10.0, coulomb=10.0)


def bias(signal: str, value: float, joint: str, robot: str = "lwr") -> str:
    """A sensor that is off."""
    return fault("sensor", robot=robot, signal=signal, joints=[joint], bias=value)


MUTATIONS: dict[str, dict[str, Mutation]] = {
    "controller_fault": {
        "stiffness halved": {f"{GAINS}.stiffness": 400},
        "no damping": {f"{GAINS}.damping": 0.0},
        "the drive is right": {"faults.wrong_sign.gain": 1.0},
        "the drive is dead": {"faults.wrong_sign.gain": 0.0},
        "half the gain": {"faults.wrong_sign.gain": -0.5},
        "another joint": {"faults.wrong_sign.joints": ["A2"]},
        "too early": {"faults.wrong_sign.begin": 1.9},
        "never put right": {"faults.wrong_sign.end": 2.5},
        "put right too late": {"faults.wrong_sign.end": 2.08},
        "stiffness doubled": {f"{GAINS}.stiffness": 1600},
        "undeclared load": load(0.5),
        "low torque limits": {
            f"{GAINS}.torque_limits": [176.0, 176.0, 50.0, 50.0, 50.0, 38.0, 38.0]
        },
        "ten times the friction": worn(),
        "no gravity compensation": {GAINS: OFF},
        "monitor deaf": {"monitor.torque_error": 0.6},
        "monitor slow": {"monitor.hold": 0.05},
        "torque sensor off": bias("torques", 3.0, "A3"),
        "encoder off": fault("encoder_offset", joints=["A2"], offset_deg=0.2),
        "elastic joints": {"run.elastic": True},
        "torque loop": {"run.torque_control": True},
    },
    "drive_home": {
        "a heavier motor": {"lwr.dynamics.motor_inertias[1]": 4.5},
        "target off by 1 mrad": {
            "targets.lwr.way_points": [[0.0, 0.35, 0.0, -1.2, 0.0, 1.101, 0.0]]
        },
        "stiffness halved": {f"{GAINS}.stiffness": 5000},
        "no damping": {f"{GAINS}.damping": 0.0},
        "damping halved": {f"{GAINS}.damping": 0.5},
        "half as fast": {"targets.lwr.speed": 0.25},
        "faster motion": {"targets.lwr.speed": 0.6},
        "gentler acceleration": {"targets.lwr.accelerations": 2.0},
        "another time law": {"targets.lwr.time_law": "quintic"},
        "wrong sign": {"targets.lwr.way_points": [[0.0, 0.35, 0.0, -1.2, 0.0, -1.1, 0.0]]},
        "another start": {"lwr.joint_angles[0]": -1.1},
        "undeclared load": load(0.5),
        "ten times the friction": worn(),
        "low torque limits": {f"{GAINS}.torque_limits": [40.0, 40.0, 40.0, 40.0, 20.0, 10.0, 10.0]},
        "controller of another kind": {GAINS: {"kind": "joint_impedance", "stiffness": 2000.0}},
        "no gravity compensation": {GAINS: OFF},
        "torque sensor off": bias("torques", 2.0, "A4"),
        "encoder off": fault("encoder_offset", joints=["A2"], offset_deg=0.1),
        "dead drive": fault("controller", joints=["A6"], gain=0.0),
        "weak drive": fault("controller", joints=["A2"], gain=0.9),
        "elastic joints": {"run.elastic": True},
        "torque loop": {"run.torque_control": True},
        "noisy torque sensors": "[sensors.lwr]\ntorques = { noise = 5.0 }\n",
    },
    "hand_guiding": {
        "other way": {"disturbances.hand.force": [0.0, -8.0, 0.0]},
        "elastic joints": {"run.elastic": True},
        "no torque loop": {"run.torque_control": False},
        "damping halved": {f"{GAINS}.damping": 2.0},
        "damping doubled": {f"{GAINS}.damping": 8.0},
        "no hand": {"disturbances.hand.force": [0.0, 1e-9, 0.0]},
        "half the force": {"disturbances.hand.force": [0.0, 4.0, 0.0]},
        "twice the force": {"disturbances.hand.force": [0.0, 16.0, 0.0]},
        "another direction": {"disturbances.hand.force": [8.0, 0.0, 0.0]},
        "all at once": {"disturbances.hand.profile": "step"},
        "in the flange's axes": {"disturbances.hand.expressed_in": "lwr/flange"},
        "no friction observer": {"lwr.torque_control.friction_bandwidth": 0.0},
        "heavier motors": {"lwr.torque_control.inertia_ratio": 0.5},
        "lighter motors": {"lwr.torque_control.inertia_ratio": 0.15},
        "undeclared load": load(0.3),
        "controller of another kind": {GAINS: {"kind": "joint_impedance", "stiffness": 100.0}},
        "no gravity compensation": {GAINS: OFF},
        "torque sensor off": bias("torques", 1.0, "A1"),
        "slow observer": {"run.observer_gain": 5.0},
        "monitor deaf": {"monitor.external_torque": 0.04},
        "low torque limits": {f"{GAINS}.torque_limits": [20.0] * 7},
        "drive delay": {"run.drive_delay": 0.01},
    },
    "haptic_position": {
        "less damping": {"controllers.left.damping": 0.6},
        "less damping on the right": {"controllers.right.damping": 0.6},
        "no left hand": {"disturbances.left_hand.force": [0.0, 0.0, -1e-9]},
        "no damping": {"controllers.left.damping": 0.0},
        "no right hand": {"disturbances.right_hand.force": [1e-9, 0.0, 0.0]},
        "left other way": {"disturbances.left_hand.force": [0.0, 0.0, 25.0]},
        "right other way": {"disturbances.right_hand.force": [-20.0, 0.0, 0.0]},
        "left hand doubled": {"disturbances.left_hand.force": [0.0, 0.0, -50.0]},
        "right hand halved": {"disturbances.right_hand.force": [10.0, 0.0, 0.0]},
        "left stiffness halved": {"controllers.left.stiffness": 5000.0},
        "right stiffness halved": {"controllers.right.stiffness": 5000.0},
        "left gives way": {"controllers.left": {"kind": "gravity_compensation", "damping": 5.0}},
        "right gives way": {"controllers.right": {"kind": "gravity_compensation", "damping": 5.0}},
        "no gravity compensation on the right": {"controllers.right": OFF},
        "softer kind of controller": {
            "controllers.left": {"kind": "joint_impedance", "stiffness": 5000.0}
        },
        "load on the right": load(0.5, "right"),
        "ten times the friction": worn("left"),
        "ten times the friction on the right": worn("right"),
        "torque sensor off": bias("torques", 2.0, "A2", "left"),
        "encoder off": fault("encoder_offset", robot="right", joints=["A1"], offset_deg=0.1),
        "low torque limits": {"controllers.right.torque_limits": 12.0},
        "base turned": {"left.base_frame": {"xyz": [0.0, 0.25, 1.0], "rpy_deg": [60, 0, 0]}},
        "elastic joints": {"run.elastic": True},
        "left hand at the right arm": {"disturbances.left_hand.at": "right/flange"},
        "torque loop": {"run.torque_control": True},
    },
    "haptic_torque": {
        "right damping doubled": {"controllers.right.damping": 10.0},
        "undeclared load": load(0.3, "left"),
        "no left hand": {"disturbances.left_hand.force": [0.0, 0.0, -1e-9]},
        "no right hand": {"disturbances.right_hand.force": [1e-9, 0.0, 0.0]},
        "left other way": {"disturbances.left_hand.force": [0.0, 0.0, 8.0]},
        "right other way": {"disturbances.right_hand.force": [-8.0, 0.0, 0.0]},
        "left doubled": {"disturbances.left_hand.force": [0.0, 0.0, -16.0]},
        "right halved": {"disturbances.right_hand.force": [4.0, 0.0, 0.0]},
        "left damping halved": {"controllers.left.damping": 2.5},
        "left is held": {"controllers.left": {"kind": "joint_position"}},
        "right is held softly": {
            "controllers.right": {"kind": "joint_impedance", "stiffness": 20.0}
        },
        "no gravity compensation on the left": {"controllers.left": OFF},
        "undeclared load on the right": load(0.3, "right"),
        "ten times the friction": worn("left"),
        "ten times the friction on the right": worn("right"),
        "torque sensor off": bias("torques", 2.0, "A2", "left"),
        "noisy torque sensors": "[sensors.right]\ntorques = { noise = 2.0 }\n",
        "torque loop": {"run.torque_control": True},
        "dead drive": fault("controller", robot="right", joints=["A2"], gain=0.0),
        "elastic joints": {"run.elastic": True},
        "low torque limits": {"controllers.left.torque_limits": 10.0},
    },
    "impedance_push": {
        "ends early": {"disturbances.push.end": 2.95},
        "damping halved": {f"{GAINS}.damping": 0.35},
        "observer half as fast": {"run.observer_gain": 25.0},
        "no push": {"disturbances.push.force": [0.0, 0.0, -1e-9]},
        "other way": {"disturbances.push.force": [0.0, 0.0, 60.0]},
        "to the side": {"disturbances.push.force": [0.0, 60.0, 0.0]},
        "half of it": {"disturbances.push.force": [0.0, 0.0, -30.0]},
        "twice as much": {"disturbances.push.force": [0.0, 0.0, -120.0]},
        "never ends": {"disturbances.push.end": 4.9},
        "stiffness halved": {f"{GAINS}.stiffness": [400, 400, 250, 250, 150, 100, 100]},
        "stiffness doubled": {f"{GAINS}.stiffness": [1600, 1600, 1000, 1000, 600, 400, 400]},
        "one stiffness halved": {f"{GAINS}.stiffness[3]": 250},
        "wrist half as stiff": {f"{GAINS}.stiffness[5]": 100},
        "no damping": {f"{GAINS}.damping": 0.0},
        "damping doubled": {f"{GAINS}.damping": 1.4},
        "undeclared load": load(0.5),
        "ten times the friction": worn(),
        "slow observer": {"run.observer_gain": 10.0},
        "elastic joints": {"run.elastic": True},
        "torque loop": {"run.torque_control": True},
        "encoder off": fault("encoder_offset", joints=["A3"], offset_deg=0.2),
        "torque sensor off": bias("torques", 3.0, "A3"),
        "noisy torque sensors": "[sensors.lwr]\ntorques = { noise = 5.0 }\n",
        "low torque limits": {f"{GAINS}.torque_limits": [60.0, 60.0, 60.0, 60.0, 60.0, 38.0, 38.0]},
        "controller of another kind": {GAINS: {"kind": "joint_position"}},
        "gravity compensation only": {GAINS: {"kind": "gravity_compensation"}},
        "no gravity compensation": {GAINS: OFF},
    },
    "payload": {
        "centre of mass aside": {"disturbances.load.center_of_mass": [0.0, 0.05, 0.07]},
        "put down too late": {"disturbances.load.end": 6.2},
        "10 % more": {"disturbances.load.mass": 4.4},
        "encoder off": fault("encoder_offset", joints=["A2"], offset_deg=0.05),
        "no load": {"disturbances.load.mass": 1e-6},
        "half of it": {"disturbances.load.mass": 2.0},
        "twice as much": {"disturbances.load.mass": 8.0},
        "centre of mass off": {"disturbances.load.center_of_mass": [0.1, 0.0, 0.07]},
        "never put down": {"disturbances.load.end": 7.99},
        "too late": {"disturbances.load.begin": 1.5},
        "stiffness halved": {f"{GAINS}.stiffness": 1500.0},
        "stiffness more": {f"{GAINS}.stiffness": 4500.0},
        "no damping": {f"{GAINS}.damping": 0.0},
        "ten times the friction": worn(),
        "torque sensor off": bias("torques", 2.0, "A2"),
        "slow observer": {"run.observer_gain": 2.0},
        "does not lift": {"targets.lwr.way_points[1]": [0.0, 0.80, 0.0, -1.3, 0.0, 1.04, 0.0]},
        "other way": {"targets.lwr.way_points[2]": [-0.1, 0.50, 0.0, -1.5, 0.0, 1.14, 0.0]},
        "not as far": {"targets.lwr.way_points[3]": [0.85, 0.80, 0.0, -1.3, 0.0, 1.04, 0.0]},
        "faster motion": {"targets.lwr.times": [1.5, 2.2, 4.5, 5.5, 6.5, 7.5]},
        "low torque limits": {f"{GAINS}.torque_limits": [45.0, 45.0, 45.0, 45.0, 45.0, 38.0, 38.0]},
        "no gravity compensation": {GAINS: OFF},
        "elastic joints": {"run.elastic": True},
        "torque loop": {"run.torque_control": True},
    },
    "sensor_fault": {
        "noise tripled": {"sensors.lwr.torques.noise": 0.15},
        "stiffness doubled": {f"{GAINS}.stiffness": 3000},
        "no gauge fault": {"faults.broken_strain_gauge.bias": 1e-6},
        "half the bias": {"faults.broken_strain_gauge.bias": 12.0},
        "other sign": {"faults.broken_strain_gauge.bias": -25.0},
        "other joint": {"faults.broken_strain_gauge.joints": ["A2"]},
        "no cut wire": {"faults.cut_wire.signal": "velocities"},
        "wire of another": {"faults.cut_wire.joints": ["A4"]},
        "cut wire too early": {"faults.cut_wire.begin": 1.5},
        "noisy torque sensors": {"sensors.lwr.torques.noise": 2.0},
        "all torque sensors off": {"sensors.lwr.torques.bias": 1.0},
        "encoder off": {"sensors.lwr.angles.resolution": 1e-2},
        "monitor deaf": {"monitor.torque_error": 0.3},
        "monitor slow": {"monitor.hold": 0.06},
        "stiffness halved": {f"{GAINS}.stiffness": 750},
        "no damping": {f"{GAINS}.damping": 0.0},
        "no swing": {"targets.lwr.amplitude_deg": 0.001},
        "smaller swing": {"targets.lwr.amplitude_deg[3]": 9},
        "faster motion": {"targets.lwr.frequency": 0.27},
        "undeclared load": load(0.3),
        "ten times the friction": fault("friction", viscous=10.0, coulomb=10.0),
        "torque loop": {"run.torque_control": True},
        "slow observer": {"run.observer_gain": 5.0},
        "no gravity compensation": {GAINS: OFF},
    },
    "singularity_pass": {
        "1 mm long": {"targets.lwr.poses": [{"xyz": [0.0, 0.0, 0.001]}, {"xyz": [0.0, 0.0, 0.0]}]},
        "no nullspace stiffness": {f"{GAINS}.nullspace_stiffness": 0.0},
        "1 mm shorter": {
            "targets.lwr.poses": [{"xyz": [0.0, 0.0, 0.134]}, {"xyz": [0.0, 0.0, 0.0]}]
        },
        "1 mm aside": {
            "targets.lwr.poses": [{"xyz": [0.0, 0.001, 0.135]}, {"xyz": [0.0, 0.0, 0.0]}]
        },
        "other way": {"targets.lwr.poses": [{"xyz": [0.0, 0.0, -0.135]}, {"xyz": [0.0, 0.0, 0.0]}]},
        "slower motion": {"targets.lwr.times": [3.5, 5.5]},
        "does not return": {
            "targets.lwr.poses": [{"xyz": [0.0, 0.0, 0.135]}, {"xyz": [0.0, 0.0, 0.05]}]
        },
        "another start": {"lwr.joint_angles[3]": -1.5},
        "stiffness halved": {f"{GAINS}.stiffness": [750, 750, 750, 50, 50, 50]},
        "stiffness doubled": {f"{GAINS}.stiffness": [3000, 3000, 3000, 200, 200, 200]},
        "turning halved": {f"{GAINS}.stiffness": [1500, 1500, 1500, 50, 50, 50]},
        "no damping": {f"{GAINS}.damping": 0.0},
        "damping halved": {f"{GAINS}.damping": 0.4},
        "undeclared load": load(0.3),
        "ten times the friction": worn(),
        "low torque limits": {f"{GAINS}.torque_limits": 30.0},
        "torque sensor off": bias("torques", 2.0, "A3"),
        "encoder off": fault("encoder_offset", joints=["A3"], offset_deg=0.2),
        "elastic joints": {"run.elastic": True},
        "torque loop": {"run.torque_control": True},
        "no gravity compensation": {GAINS: OFF},
        "dead drive": fault("controller", joints=["A5"], gain=0.0),
    },
    "table_contact": {
        "1 mm deeper": {
            "targets.lwr.poses": [
                {"xyz": [0.0, 0.0, 0.101]},
                {"xyz": [-0.12, 0.0, 0.101]},
                {"xyz": [-0.12, 0.0, 0.0]},
            ]
        },
        "no damping": {f"{GAINS}.damping": 0.0},
        "no table": {"objects.table.frame": {"xyz": [-0.62, 0.0, -0.5]}},
        "table 1 mm higher": {"objects.table.frame": {"xyz": [-0.62, 0.0, 0.076]}},
        "table 1 cm lower": {"objects.table.frame": {"xyz": [-0.62, 0.0, 0.065]}},
        "stiffness halved": {f"{GAINS}.stiffness[2]": 500},
        "stiffness doubled": {f"{GAINS}.stiffness[2]": 2000},
        "aside halved": {f"{GAINS}.stiffness": [1000, 1000, 1000, 100, 100, 100]},
        "turning doubled": {f"{GAINS}.stiffness": [2000, 2000, 1000, 200, 200, 200]},
        "less damping": {f"{GAINS}.damping": 0.45},
        "5 mm less deep": {
            "targets.lwr.poses": [
                {"xyz": [0.0, 0.0, 0.095]},
                {"xyz": [-0.12, 0.0, 0.095]},
                {"xyz": [-0.12, 0.0, 0.0]},
            ]
        },
        "shorter": {
            "targets.lwr.poses": [
                {"xyz": [0.0, 0.0, 0.1]},
                {"xyz": [-0.10, 0.0, 0.10]},
                {"xyz": [-0.10, 0.0, 0.0]},
            ]
        },
        "other way": {
            "targets.lwr.poses": [
                {"xyz": [0.0, 0.0, 0.1]},
                {"xyz": [0.12, 0.0, 0.10]},
                {"xyz": [0.12, 0.0, 0.0]},
            ]
        },
        "stays down": {
            "targets.lwr.poses": [
                {"xyz": [0.0, 0.0, 0.1]},
                {"xyz": [-0.12, 0.0, 0.10]},
                {"xyz": [-0.12, 0.0, 0.10]},
            ]
        },
        "undeclared load": load(0.3),
        "ten times the friction": worn(),
        "slippery table": {"objects.table.friction": 0.1},
        "torque loop": {"run.torque_control": True},
        "elastic joints": {"run.elastic": True},
        "torque sensor off": bias("torques", 3.0, "A2"),
        "encoder off": fault("encoder_offset", joints=["A2"], offset_deg=0.2),
        "no gravity compensation": {GAINS: OFF},
        "controller of another kind": {GAINS: {"kind": "joint_impedance", "stiffness": 1000.0}},
        "low torque limits": {f"{GAINS}.torque_limits": [30.0, 30.0, 30.0, 30.0, 30.0, 30.0, 30.0]},
    },
    "justin_push": {
        "hand halved": {"controllers.justin_left_hand.stiffness": 2},
        "undeclared load on the right": load(0.5, "justin_right_arm"),
        "no push": {"disturbances.push.force": [-1e-9, 0.0, 0.0]},
        "other arm": {"disturbances.push.at": "justin_right_arm/flange"},
        "half of it": {"disturbances.push.force": [-60.0, 0.0, -50.0]},
        "other way": {"disturbances.push.force": [120.0, 0.0, 100.0]},
        "never ends": {"disturbances.push.end": 3.95},
        "stiffness halved": {"controllers.justin.stiffness": 300},
        "stiffness doubled": {"controllers.justin.stiffness": 1200},
        "torso halved": {"controllers.justin_torso.stiffness": [1000, 2000, 1500]},
        "torso is let go": {
            "controllers.justin_torso": {"kind": "gravity_compensation", "damping": 5.0}
        },
        "damping halved": {"controllers.justin.damping": 0.35},
        "left hand lets go": {"controllers.justin_left_hand": OFF},
        "undeclared load on the left": load(0.5, "justin_left_arm"),
        "ten times the friction": worn("justin_left_arm"),
        "encoder off": fault(
            "encoder_offset", robot="justin_right_arm", joints=["A2"], offset_deg=0.2
        ),
        "torque sensor off": bias("torques", 3.0, "A2", "justin_right_arm"),
    },
    "hit_hand_grasp": {
        "can doubled": {"objects.can.mass": 0.4},
        "thumb halved": {"controllers.hand_thumb.stiffness": [0.5, 0.5, 0.5, 0.0]},
        "no thumb": {"controllers.hand_thumb.stiffness": [0.05, 0.05, 0.05, 0.0]},
        "thumb doubled": {"controllers.hand_thumb.stiffness": [2.0, 2.0, 2.0, 0.0]},
        "fingers halved": {"controllers.hand.stiffness": [1.5, 1.5, 1.5, 0.0]},
        "does not close": {"targets.hand.way_points[1]": [0.0, 0.1, 0.1, 0.1]},
        "thumb does not close": {"targets.hand_thumb.way_points[1]": [0.0, 0.1, 0.1, 0.1]},
        "can of 1 kg": {"objects.can.mass": 1.0},
        "can slippery": {"objects.can.friction": 0.1},
        "can 1 cm off": {"objects.can.frame": {"xyz": [-0.772, -0.042, 0.412]}},
        "lift 5 mm lower": {
            "targets.arm.poses": [
                {"xyz": [0.0, 0.0, 0.1]},
                {"xyz": [0.0, 0.0, 0.1]},
                {"xyz": [0.0, 0.145, 0.1]},
            ]
        },
        "no lift": {
            "targets.arm.poses": [
                {"xyz": [0.0, 0.0, 0.1]},
                {"xyz": [0.0, 0.0, 0.1]},
                {"xyz": [0.0, 0.0, 0.1]},
            ]
        },
        "short reach": {
            "targets.arm.poses": [
                {"xyz": [0.0, 0.0, 0.08]},
                {"xyz": [0.0, 0.0, 0.08]},
                {"xyz": [0.0, 0.15, 0.08]},
            ]
        },
        "arm half as stiff": {"controllers.arm.stiffness": [1500, 1500, 1500, 100, 100, 100]},
        "undeclared load": load(0.5, "arm"),
        "ten times the friction": worn("arm"),
        "no gravity compensation": {"controllers.arm": OFF},
    },
    "biped_stand": {
        "ankles half as stiff aside": {"controllers.biped.stiffness[5]": 1000},
        "encoder off": fault("encoder_offset", robot="biped_left", joints=["knee"], offset_deg=1.0),
        "ankles half as stiff": {"controllers.biped.stiffness[4]": 1000},
        "all half as stiff": {
            "controllers.biped.stiffness": [400, 1000, 1000, 1000, 1000, 1000, 100]
        },
        "all twice as stiff": {
            "controllers.biped.stiffness": [1600, 4000, 4000, 4000, 4000, 4000, 400]
        },
        "knees halved": {"controllers.biped.stiffness[3]": 1000},
        "no damping": {"controllers.biped.damping": 0.0},
        "no forward push": {"disturbances.push_forward.force": [1e-9, 0.0, 0.0]},
        "no push aside": {"disturbances.push_aside.force": [1e-9, 0.0, 0.0]},
        "forward doubled": {"disturbances.push_forward.force": [80.0, 0.0, 0.0]},
        "backward": {"disturbances.push_forward.force": [-40.0, 0.0, 0.0]},
        "other side": {"disturbances.push_aside.force": [0.0, 30.0, 0.0]},
        "aside doubled": {"disturbances.push_aside.force": [0.0, -60.0, 0.0]},
        "no gravity compensation": {"controllers.biped": OFF},
        "gravity only": {"controllers.biped": {"kind": "gravity_compensation"}},
        "ten times the friction": worn("biped_left"),
        "low torque limits": {"controllers.biped.torque_limits": 15.0},
        "push all at once": {"disturbances.push_forward.profile": "step"},
    },
}


_compiler = Compiler()  # most mutations are of the same world


def mutated(name: str, mutation: Mutation, folder: Path) -> Scenario:
    """A shipped scenario with something wrong in it."""
    if not isinstance(mutation, str):
        return read_scenario(name, mutation)
    file = folder / f"{name}.toml"
    file.write_text(f"{find_scenario(name).read_text()}\n{mutation}")
    return read_scenario(file)


def noticed(scenario: Scenario) -> list[str]:
    """What is expected and does not hold, or what ends the run; as soon as it is known."""

    def known_at(expect: Expect) -> float:
        return scenario.duration if expect.before is None else expect.before

    simulation = Simulation(scenario, compiler=_compiler)
    for time in sorted({*map(known_at, scenario.expect.values()), scenario.duration}):
        try:
            simulation.advance(round(time / scenario.run.timestep))
        except SimulationError as error:
            return [str(error)]
        failed = [
            outcome.name
            for outcome, expect in zip(simulation.outcomes(), scenario.expect.values(), strict=True)
            if known_at(expect) <= time and not outcome.holds
        ]
        if failed:
            return failed
    return []


def test_every_shipped_scenario_is_mutated() -> None:
    assert sorted(MUTATIONS) == sorted(list_scenarios())
    for name, mutations in MUTATIONS.items():
        assert len(mutations) >= LEAST, name


@pytest.mark.parametrize("name", list_scenarios() if TRIED != 2 else ["impedance_push"])
def test_nothing_is_noticed_where_nothing_is_wrong(name: str) -> None:
    assert noticed(read_scenario(name)) == []


@pytest.mark.parametrize(
    ("name", "what"),
    [
        pytest.param(name, what, marks=[pytest.mark.thorough] if name in SLOW else [])
        for name, mutations in MUTATIONS.items()
        for what in list(mutations)[:TRIED]
    ],
)
def test_what_is_wrong_is_noticed(name: str, what: str, tmp_path: Path) -> None:
    assert noticed(mutated(name, MUTATIONS[name][what], tmp_path)), f"{name}: {what}"
