"""Overriding values of files by dotted keys with indices."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sero_mj import SerialRobot
from sero_mj.base.dotted_keys import parts_of, with_value
from sero_mj.base.errors import DeclarationError
from sero_mj.cli import main
from sero_mj.load import load_scene
from sero_mj.simulate.scenario_file import read_scenario

names = st.from_regex(r"[a-z_][a-z0-9_-]{0,5}", fullmatch=True)


@given(names, st.lists(names | st.integers(0, 99), max_size=5))
def test_key_is_split_into_the_parts_it_was_built_from(first: str, rest: list[str | int]) -> None:
    key = first + "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in rest)
    assert parts_of(key) == [first, *rest]


@pytest.mark.parametrize(
    "key", ["", ".", "a.", "a..b", "[0]", "a[", "a[0", "a[-1]", "a[x]", "a[0]b"]
)
def test_invalid_key_is_rejected(key: str) -> None:
    with pytest.raises(ValueError, match="expected names separated by dots, with indices such as"):
        parts_of(key)


def test_with_value_does_not_change_its_arguments() -> None:
    table = {"a": {"b": [1, [2, 3]]}, "c": 4}
    assert with_value(table, ["a", "b", 1, 0], 9) == {"a": {"b": [1, [9, 3]]}, "c": 4}
    assert with_value(table, ["a", "d", "e"], 9)["a"] == {"b": [1, [2, 3]], "d": {"e": 9}}
    assert with_value({"k": 2.0}, ["k", 1], 9, n=3) == {"k": [2.0, 9, 2.0]}
    assert with_value({"k": [1, 2]}, ["k"], 9) == {"k": [9, 9]}
    assert table == {"a": {"b": [1, [2, 3]]}, "c": 4}


def test_elements_and_nested_tables_of_a_robot_file_are_overridden() -> None:
    plain = load_scene("lwr_udp").robots["lwr"]
    robot = load_scene(
        "lwr_udp",
        {
            "lwr.dynamics.mass_scale": 1.5,
            "lwr.dynamics.coulomb_friction[1]": 0.25,
            "lwr.position_limits[2][0]": -1.0,
            "lwr.torque_limits": 50,
        },
    ).robots["lwr"]
    friction, before = robot.dynamics.coulomb_friction, plain.dynamics.coulomb_friction
    assert robot.dynamics.mass_scale == 1.5
    assert friction is not None and before is not None
    assert friction[1] == 0.25 and (np.delete(friction, 1) == np.delete(before, 1)).all()
    assert robot.position_limits is not None and plain.position_limits is not None
    changed = robot.position_limits != plain.position_limits
    assert np.argwhere(changed).tolist() == [[2, 0]] and robot.position_limits[2, 0] == -1.0
    assert robot.torque_limits is not None and robot.torque_limits.tolist() == [50.0] * 7


def test_elements_of_lists_in_a_scenario_are_overridden() -> None:
    scenario = read_scenario(
        "impedance_push",
        {
            "controllers.lwr.stiffness[3]": 333.0,
            "disturbances.push.force[0]": 1.0,
            "lwr.dynamics.mass_scale": 1.1,
            "run.duration": 6.0,
        },
    )
    stiffness = np.broadcast_to(scenario.controllers["lwr"].stiffness, 7)
    plain = np.broadcast_to(read_scenario("impedance_push").controllers["lwr"].stiffness, 7)
    assert stiffness[3] == 333.0 and (np.delete(stiffness, 3) == np.delete(plain, 3)).all()
    assert scenario.disturbances["push"].force[0] == 1.0
    assert scenario.scene.robots["lwr"].dynamics.mass_scale == 1.1


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("lwr.dynamics.mas_scale", "unknown key; did you mean 'mass_scale'?"),
        ("lwr.torque_limits[9]", "'torque_limits' has no element [9]; it has 7, counted from [0]"),
        ("lwr.name[0]", "'name' is not a list; set it as a whole"),
        (
            "lwr.dynamics.coulom_friction[1]",
            "unknown key; did you mean 'coulomb_friction'?",
        ),
        (
            "lwr.acceleration_limits[1]",
            "'acceleration_limits' has no elements yet; set it as a whole",
        ),
        ("lwr.torque_limits.x", "'torque_limits' is not a table"),
        ("lwr.torque_limits[x]", "expected names separated by dots, with indices such as [0]"),
        ("controllers.lwr.stifness", "unknown key; did you mean 'stiffness'?"),
        ("controllers.lrw.stiffness", "no robot 'lrw'; did you mean 'lwr'?"),
        (
            "controllers.lwr.null.stiffness",
            "unknown key; available: damping, damping_every,",
        ),
        ("sensors.lwr.torqes.noise", "unknown key; did you mean 'torques'?"),
        ("sensors.lwr.torques.nois", "unknown key; did you mean 'noise'?"),
        ("targets.lwr.amplitude", "there is no [targets.lwr], and in a new one, kind is required"),
        ("disturbances.pus.force[0]", "there is no [disturbances.pus]; did you mean 'push'?"),
        ("disturbances.pus.begin", "there is no [disturbances.pus]; did you mean 'push'?"),
        (
            "disturbances.load.mass",
            "there is no [disturbances.load], and in a new one, kind is",
        ),
        ("expect.new.above", "there is no [expect.new], and in a new one, found none; expected"),
        ("robots.lrw.show_axes", "there is no [robots.lrw]; did you mean 'lwr'?"),
        ("lwr.dynamics.joint.friction", "unknown key; available: centers_of_mass,"),
        ("view.look_art", "unknown key; did you mean 'look_at'?"),
        ("arrows.tip.radius", "there is no [arrows.tip], and in a new one, at is required"),
        ("groups.arms.show_axes", "no group 'arms'; none is available"),
        (
            "lwr",
            "the key has no field; expected the names of a robot and a field, such as "
            "lwr.joint_angles",
        ),
        ("controlers.lwr.stiffness", "no robot 'controlers' to set this for; did you mean 'contro"),
        ("run.duratio", "unknown key; did you mean 'duration'?"),
    ],
)
def test_invalid_key_gets_one_message(key: str, message: str, capsys: Any) -> None:
    with pytest.raises(SystemExit):
        main(["simulate", "impedance_push", "--set", f"{key}=3"])
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"sero-mj: --set {key}: {message}")
    with pytest.raises(DeclarationError) as caught:
        read_scenario("impedance_push", {key: 3})
    assert len(caught.value.problems) == 1


ARM = """
dh_convention = "craig"
dh_params_deg = [[0, 0, 0, 0.3], [-90, 0, 0, 0]]
position_limits_deg = [[-170, 170], [-90, 90]]
flange_frame = { xyz = [0.1, 0.0, 0.2], rpy_deg = [0, 90, 0] }

[dynamics]
masses = [1.0, 2.0, 1.0]
centers_of_mass = [[0, 0, 0], [0, 0, 0.1], [0.1, 0, 0]]
inertias = [[0.01, 0.01, 0.01, 0, 0, 0], [0.02, 0.02, 0.01, 0, 0, 0], [0.01, 0.01, 0.01, 0, 0, 0]]
"""


WRONG = {
    "lwr.show_arows": True,
    "lwr.joint_angles[9]": 1.0,
    "lwr.dynamics.motor_inertia[1]": 4.0,
    "lwr.dynamics.coulomb_friction": "x",
    "controllers.lwr.dampin": 1.0,
    "targets.lwr.speed": -1.0,
    "run.duratio": 3.0,
    "expect.final_position_error.belo": 1.0,
    "view.azimut": 3.0,
    "foo": 1,
}


@pytest.mark.parametrize(("one", "other"), [*itertools.permutations(WRONG, 2)])
def test_two_invalid_keys_are_both_reported(one: str, other: str) -> None:
    with pytest.raises(DeclarationError) as raised:
        read_scenario("drive_home", {key: WRONG[key] for key in (one, other)})
    told = [problem.key for problem in raised.value.problems]
    assert len(told) == 2
    assert all(any(each.endswith(key) for each in told) for key in (one, other)), told


def test_all_set_options_without_a_value_are_reported_together(capsys: Any) -> None:
    with pytest.raises(SystemExit):
        main(["simulate", "drive_home", "--set", "nonsense", "--set", "lwr.show_axes"])
    assert "--set nonsense, --set lwr.show_axes: expected ROBOT" in capsys.readouterr().err


def test_values_of_a_robot_file_are_overridden_in_its_own_units(tmp_path: Path) -> None:
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "robot.toml").write_text(ARM)
    scene = tmp_path / "scene.toml"
    scene.write_text('[robots.arm]\nmodel = "arm"\n')

    def arm(key: str, value: object) -> SerialRobot:
        return load_scene(scene, {f"arm.{key}": value}).robots["arm"]

    plain = load_scene(scene).robots["arm"]
    limits = np.rad2deg(arm("position_limits_deg[1][0]", -33.0).position_limits)
    np.testing.assert_allclose(limits, [[-170, 170], [-33, 90]])
    rows = arm("dh_params_deg[0][3]", 0.5).dh_params
    np.testing.assert_allclose(rows, [[0, 0, 0, 0.5], [-np.pi / 2, 0, 0, 0]])
    T = arm("flange_frame.xyz[2]", 0.7).flange_frame
    np.testing.assert_allclose(T[:3, 3], [0.1, 0.0, 0.7])
    np.testing.assert_array_equal(T[:3, :3], plain.flange_frame[:3, :3])
    dynamics = arm("dynamics.inertias[1][0]", 0.025).dynamics
    assert dynamics.inertias[1, 0, 0] == 0.025 and dynamics.inertias[1, 1, 1] == 0.02
    np.testing.assert_array_equal(dynamics.masses, plain.dynamics.masses)
    assert arm("dynamics.mass_scale", 1.5).dynamics.masses[1] == 2.0


def test_force_can_be_overridden_with_zero() -> None:
    scenario = read_scenario("impedance_push", {"disturbances.push.force": [0.0, 0.0, 0.0]})
    assert not scenario.disturbances["push"].force.any()


def test_overrides_can_create_missing_tables() -> None:
    scenario = read_scenario(
        "impedance_push",
        {
            "sensors.lwr.torques.noise": 0.1,
            "sensors.lwr.velocities.bias[2]": 0.5,
            "controllers.lwr.damping[1]": 0.3,
            "monitor.torque_error": 0.4,
            "run.gravity[2]": -1.6,
            "faults.stuck": {"kind": "frozen_sensor", "signal": "torques"},
            "disturbances.load.kind": "payload",
            "disturbances.load.robot": "lwr",
            "disturbances.load.mass": 2.0,
            "expect.light.measure": "torque_share",
            "expect.light.below": 0.9,
            "view.distance": 2.25,
            "objects.box.shape": "box",
            "objects.box.size": [0.1, 0.1, 0.1],
            "lwr.torques": 5,
            "lwr.dynamics.coulomb_friction": 0.5,
            "floor": False,
        },
    )
    sensors, scene = scenario.sensors["lwr"], scenario.scene
    assert sensors.torques.noise == 0.1
    assert sensors.velocities.bias.tolist() == [0, 0, 0.5, 0, 0, 0, 0]
    assert scenario.controllers["lwr"].damping.tolist() == [0.7, 0.3, *[0.7] * 5]
    assert scenario.monitor.torque_error == 0.4 and scenario.run.gravity.tolist()[2] == -1.6
    assert scenario.faults["stuck"].signal == "torques"
    assert scenario.disturbances["load"].mass == 2.0 and "push" in scenario.disturbances
    assert scenario.expect["light"].below == 0.9 and len(scenario.expect) > 5
    assert scene.view.distance == 2.25 and not scene.floor
    assert [each.name for each in scene.objects] == ["box"]
    assert scene.robots["lwr"].torques.tolist() == [5.0] * 7
    assert scene.robots["lwr"].dynamics.coulomb_friction.tolist() == [0.5] * 7


def test_keys_of_scenes_and_groups_are_overridden() -> None:
    scene = load_scene(
        "lwr_udp", {"sources.udp.port": 32123, "routes.lwr.commanded_torques": "udp.values1"}
    )
    assert scene.sources["udp"]["port"] == 32123
    assert scene.routes["lwr.commanded_torques"] == "udp.values1"
    plain = read_scenario("justin_push")
    pushed = read_scenario(
        "justin_push",
        {
            "controllers.justin_left_arm.stiffness": 100,  # overrides the value of the group justin
            "justin.torque_limits": 50,
            "justin.base_frame.xyz[0]": 0.5,
            "groups.justin.show_arrows": False,
        },
    )
    stiffness, before = (
        {name: float(np.max(each.stiffness)) for name, each in scenario.controllers.items()}
        for scenario in (pushed, plain)
    )
    assert stiffness == {**before, "justin_left_arm": 100.0}
    for name, robot in pushed.scene.robots.items():
        assert robot.torque_limits.tolist() == [50.0] * robot.n
        moved = robot.base_frame - plain.scene.robots[name].base_frame
        assert moved[0, 3] == (0.5 if robot.mount is None else 0.0)
        assert plain.scene.robots[name].show_arrows and not robot.show_arrows


def test_list_of_the_wrong_size_for_robots_of_a_group_is_reported_once() -> None:
    with pytest.raises(DeclarationError) as caught:
        load_scene("justin", {"justin.torque_limits": [1, 2, 3]})
    (problem,) = caught.value.problems
    assert problem.message.startswith("found 3 entries; expected 2, one per row of dh_params (")


@pytest.mark.parametrize(
    ("settings", "keys"),
    [
        ({"lwr.joint_angle": 3, "lwrr.torques": 1}, {"joint_angle", "lwrr.torques"}),
        ({"a.b": 1, "c.d": 2, "lwr.model": "lwr"}, {"a.b", "c.d", "lwr.model"}),
    ],
)
def test_all_invalid_overrides_of_a_robot_are_reported(
    settings: dict[str, object], keys: set[str]
) -> None:
    with pytest.raises(DeclarationError) as caught:
        load_scene("lwr", settings)
    assert {problem.key for problem in caught.value.problems} == keys
