"""Coupled joints in declarations, packets, routes, and simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sero_mj import DeclarationError, Double, Mirror, Plant, Scene, SerialRobot, World, load_scene
from sero_mj.data.drive.place import Router
from sero_mj.data.drive.wiring import wire
from sero_mj.data.send.motion import SineMotion
from sero_mj.simulate.scenario import Scenario
from sero_mj.simulate.simulation import Simulation

COUPLED = {
    "J3": {"to": "J2", "ratio": 2.0, "offset": 0.1},
    "J4": {"to": "J3", "ratio": -0.5},  # over another coupled one
}


def finger(**fields: Any) -> SerialRobot:
    return SerialRobot(
        **{
            "name": "finger",
            "dh_convention": "craig",
            "dh_params": [[0, 0, 0, 0.02], [1.5, 0, 0, 0], [0, 0.05, 0, 0], [0, 0.04, 0, 0]],
            "flange_frame": {"xyz": [0.03, 0, 0]},
            "couplings": COUPLED,
            **fields,
        }
    )


def expected(first: float, second: float) -> list[float]:
    third = 2.0 * second + 0.1
    return [first, second, third, -0.5 * third]


def routed(routes: dict[str, str], structure: str, **fields: Any) -> Scene:
    sources = {"udp": {"kind": "udp", "port": 0, "structure": structure}}
    return Scene(robots=[finger()], routes=routes, sources=sources, floor=False, **fields)


def apply(scene: Scene, **values: list[float]) -> tuple[World, Any]:
    wiring = wire(scene).check(scene)
    world = World(scene)
    data = world.make_data()
    arrays = {key: np.array(numbers, float) for key, numbers in values.items()}
    Router(world, wiring.routes).apply(data, {"udp": arrays})
    return world, data


def test_declared_angles_can_omit_coupled_joints() -> None:
    np.testing.assert_allclose(finger(joint_angles=[0.3, 0.2]).home, expected(0.3, 0.2))
    np.testing.assert_allclose(finger().home, expected(0.0, 0.0))
    whole = finger(joint_angles=expected(0.3, 0.2))
    np.testing.assert_allclose(whole.home, expected(0.3, 0.2))
    with pytest.raises(DeclarationError) as caught:
        finger(joint_angles=[0.3, 0.2, 0.4, 0.0])
    assert str(caught.value) == (
        "joint_angles: found 0.4 for J3; expected 0.5 because of its coupling"
    )
    with pytest.raises(DeclarationError) as caught:
        finger(joint_angles=[0.3, 0.2, 0.4])
    assert str(caught.value) == (
        "joint_angles: found 3 entries; expected 4, one per row of dh_params, or 2 without the "
        "coupled joints"
    )


def test_declared_values_can_omit_coupled_joints() -> None:
    own = {"torques": [5, 6], "commanded_torques": [5, 6, 7, 8], "joint_accelerations": [1, 3],
           "billboard_values": [1, 2]}  # fmt: skip
    robot = finger(**own)
    robot.show_arrows = True  # checks all fields again
    world = World(Scene(robots=[robot]))
    data = world.make_data()
    shown = {key: data.userdata[world.slots[f"finger.{key}"]].tolist() for key in own}
    np.testing.assert_equal(shown, {
        "torques": [5, 6, np.nan, np.nan], "commanded_torques": [5, 6, 7, 8],
        "joint_accelerations": [1, 3, 6, -3], "billboard_values": [1, 2, np.nan, np.nan],
    })  # fmt: skip
    with pytest.raises(DeclarationError) as caught:
        finger(torques=[1], billboard_values=[1, 2, 3, 4, 5])
    many = "one per row of dh_params, or 2 without the coupled joints"
    assert [str(problem) for problem in caught.value.problems] == [
        f"torques: found 1 entries; expected 4, {many}",
        f"billboard_values: found 5 entries; expected 4, {many}",
    ]


def test_invalid_coupling_is_reported_without_consequent_errors() -> None:
    with pytest.raises(DeclarationError) as caught:
        finger(couplings={"J4": {"to": "J3", "ratioi": 2.0}}, joint_angles=[0, 0, 0], torques=[1])
    assert str(caught.value) == "couplings.J4.ratioi: unknown key; did you mean 'ratio'?"


def test_packets_carry_the_independent_joints_or_all() -> None:
    keys = ("joint_angles", "torques", "joint_accelerations")
    routes = {f"finger.{key}": f"udp.values{i}" for i, key in enumerate(keys)}
    world, data = apply(
        routed(routes, "2F2F2F"), values0=[0.3, 0.2], values1=[5.0, 6.0], values2=[1.0, 3.0]
    )
    part = world.robots["finger"]
    np.testing.assert_allclose(data.qpos[part.qpos], expected(0.3, 0.2))
    torques = data.userdata[world.slots["finger.torques"]]
    np.testing.assert_array_equal(torques, [5.0, 6.0, np.nan, np.nan])  # the other joints: no data
    np.testing.assert_allclose(
        data.userdata[world.slots["finger.joint_accelerations"]], [1.0, 3.0, 6.0, -3.0]
    )
    received = [0.3, 0.2, 0.9, 0.8]  # all joints: shown as received, regardless of the coupling
    world, data = apply(routed({"finger.joint_angles": "udp.values0"}, "4F"), values0=received)
    np.testing.assert_allclose(data.qpos[world.robots["finger"].qpos], received)


def test_slices_of_packets_in_other_units_are_coupled() -> None:
    routes = {"finger.joint_angles": "udp.values0[3:1:-1] * deg"}
    world, data = apply(routed(routes, "4F"), values0=[0.0, 0.0, 10.0, 20.0])
    np.testing.assert_allclose(
        data.qpos[world.robots["finger"].qpos], expected(*np.deg2rad([20.0, 10.0]))
    )


def test_wrong_number_of_values_is_reported_with_both_valid_numbers() -> None:
    scene = routed({"finger.joint_angles": "udp.values0"}, "3F")
    assert [str(problem) for problem in wire(scene).problems] == [
        "routes.finger.joint_angles: udp.values0 has 3 values, but finger.joint_angles takes 4, "
        "one per joint, or 2 without the coupled ones"
    ]


def test_inputs_set_in_code_and_doubles_accept_both_numbers_of_joints() -> None:
    path = np.array([[0.0, 0.0], [0.2, 0.4]])
    doubles = [
        Double(name="goal", of="finger", joint_angles=[0.3, 0.2]),
        Double(name="way", of="finger", path=path, path_length=2),
    ]
    mirror = Mirror(Scene(robots=[finger()], doubles=doubles))
    world, data = mirror.world, mirror.data
    world.set_input(data, "finger.joint_angles", [0.1, 0.3])
    np.testing.assert_allclose(data.qpos[world.robots["finger"].qpos], expected(0.1, 0.3))
    np.testing.assert_allclose(data.userdata[world.slots["goal.joint_angles"]], expected(0.3, 0.2))
    np.testing.assert_allclose(world.doubles["way"].path, [expected(0, 0), expected(0.2, 0.4)])


def test_simulated_coupling_holds_and_carries_load() -> None:
    """Virtual work: the independent joint carries the gravity of everything that moves with it."""
    still = {"viscous_friction": [0.01] * 4, "coulomb_friction": [0.0] * 4}
    motors = {"motor_inertias": [1e-4] * 4}
    links = {
        "masses": [0.1, 0.2, 0.15, 0.1], "centers_of_mass": [[0.02, 0, 0]] * 4,
        "inertias": [[1e-4] * 3 + [0.0] * 3] * 4,
    }  # fmt: skip
    links = {key: [*value, value[-1]] for key, value in links.items()}
    robot = finger(joint_angles=[0.1, 0.2], dynamics={**links, **still, **motors})
    plant = Plant(World(Scene(robots=[robot], floor=False), dynamic=True))
    gravity = plant.measured[2].copy()
    slope = np.array([[1, 0], [0, 1], [0, 2], [0, -1.0]])
    hold = np.array([*(slope.T @ gravity), 0.0, 0.0])  # no motors at coupled joints
    for _ in range(500):
        plant.step(hold)
    np.testing.assert_allclose(plant.measured[0], expected(0.1, 0.2), atol=2e-4)
    # The joints transmit the weight of their links; there are no external forces.
    np.testing.assert_allclose(plant.measured[2], gravity, atol=1e-3)
    np.testing.assert_allclose(plant.external_torques(), 0.0, atol=1e-3)
    push = np.array([0.0, 0.02, 0.0, 0.0])
    for _ in range(300):
        plant.step(hold + push)
    first, second = plant.measured[0][:2]
    assert second > 0.25  # it moves the others
    np.testing.assert_allclose(plant.measured[0], expected(first, second), atol=1e-3)


def test_targets_of_controllers_respect_the_coupling() -> None:
    robot = finger(joint_angles=[0.1, 0.2])
    simulation = Simulation(
        Scenario(
            Scene(robots=[robot], floor=False),
            controllers={"finger": {"kind": "joint_impedance", "stiffness": 2.0, "damping": 0.7}},
            targets={"finger": {"kind": "step", "amplitude": 0.2, "time": 0.0}},
            duration=1.0,
        )
    )
    simulation.advance(simulation.steps)
    target = simulation.log.of("finger", "target_angles")[-1]
    np.testing.assert_allclose(target, expected(0.3, 0.4))
    np.testing.assert_allclose(simulation.plant.actual[0], target, atol=0.02)
    assert np.abs(simulation.log.of("finger", "external_torques")[-1]).max() < 0.01


def test_sent_motions_respect_the_coupling() -> None:
    motion = SineMotion(finger())
    position, velocity, _ = motion.at(0.7)
    np.testing.assert_allclose(position, expected(*position[:2]))
    after, before = motion.at(0.7 + 1e-6)[0], motion.at(0.7 - 1e-6)[0]
    np.testing.assert_allclose((after - before) / 2e-6, velocity, atol=1e-6)


WRONG = """\
[robots.finger]
dh_convention = "craig"
dh_params = [[0, 0, 0, 0.02], [1.5, 0, 0, 0], [0, 0.05, 0, 0], [0, 0.04, 0, 0]]
joint_names = ["base", "knuckle", "middle", "tip"]

[robots.finger.couplings]
tip = { to = "midle" }
thumb = { to = "base" }
base = { to = "knuckle" }
knuckle = { to = "base" }
middle = { to = "tip", ratio = 0.0 }
"""


def test_invalid_couplings_are_reported_with_their_lines(tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(WRONG)
    with pytest.raises(DeclarationError) as caught:
        load_scene(path)
    assert [str(problem) for problem in caught.value.problems] == [
        f"{path}:11: robots.finger.couplings.middle.ratio: found 0; expected a nonzero ratio, "
        "because 0 would fix the joint"
    ]
    path.write_text(WRONG.replace("ratio = 0.0", "ratio = 1.0"))
    with pytest.raises(DeclarationError) as caught:
        load_scene(path)
    assert [str(problem) for problem in caught.value.problems] == [
        f"{path}:7: robots.finger.couplings.tip.to: no joint 'midle'; did you mean 'middle'?",
        f"{path}:8: robots.finger.couplings.thumb: no joint 'thumb'; available: base, knuckle, "
        "middle, tip",
        f"{path}:9: robots.finger.couplings.base: joints are coupled in a cycle: base to knuckle "
        "to base",
    ]
