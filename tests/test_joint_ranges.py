"""Finite display ranges of joints without limits, and their users."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from sero_mj.base.errors import DeclarationError
from sero_mj.data.send.motion import SineMotion
from sero_mj.load import load_scene
from sero_mj.robots.declared.inverse_kinematics import independent_limits
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.simulate.endless_run import bent_pose
from sero_mj.viewer.session.joint_goal import JointGoal

INF = math.inf
_LIMIT = {"revolute": 'lower="-2.4" upper="2.4"', "continuous": ""}


def gen3_like(tmp_path: Path, effort: str = 'effort="39"') -> Path:
    """Returns an arm with the joints of a Kinova Gen3: 1, 3, 5 and 7 are continuous."""
    text, below = '<robot name="gen3"><link name="base"/>', "base"
    for i in range(1, 8):
        kind, axis = ("continuous", "0 0 1") if i % 2 else ("revolute", "0 1 0")
        torque = effort if i == 7 else 'effort="39"'
        limit = f'<limit {_LIMIT[kind]} velocity="1.39" {torque}/>'
        text += (
            f'<joint name="j{i}" type="{kind}"><origin xyz="0 0 0.15"/><parent link="{below}"/>'
            f'<child link="l{i}"/><axis xyz="{axis}"/>{limit}</joint><link name="l{i}"><inertial>'
            '<origin xyz="0 0 0.07"/><mass value="1"/><inertia ixx="0.005" iyy="0.005" '
            'izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial><visual><origin xyz="0 0 0.07"/>'
            '<geometry><box size="0.05 0.05 0.1"/></geometry></visual></link>'
        )
        below = f"l{i}"
    path = tmp_path / "gen3.urdf"
    path.write_text(text + "</robot>")
    return path


@pytest.mark.parametrize(
    ("kind", "limits", "home", "expected"),
    [
        ("revolute", (-2.0, 1.0), 0.0, (-2.0, 1.0)),
        ("revolute", (-INF, INF), 0.0, (-np.pi, np.pi)),
        ("revolute", (-1e6, 1e6), 0.0, (-np.pi, np.pi)),
        ("prismatic", (-INF, INF), 0.0, (-1.0, 1.0)),
        ("prismatic", (-1e6, 1e6), 0.0, (-1.0, 1.0)),
        ("prismatic", (-20.0, 20.0), 0.0, (-20.0, 20.0)),
        ("prismatic", (0.0, INF), 0.0, (0.0, 1.0)),
        ("prismatic", (5.0, INF), 5.0, (5.0, 6.0)),
        ("revolute", (-INF, -4.0), -4.0, (-4.0 - np.pi, -4.0)),
        ("revolute", (-INF, INF), 7.0, (7.0 - np.pi, 7.0 + np.pi)),
    ],
)
def test_display_range_is_finite_and_contains_the_home_position(
    kind: str, limits: tuple[float, float], home: float, expected: tuple[float, float]
) -> None:
    robot = SerialRobot(
        dh_params=[[0, 0, 0, 0.2]],
        dh_convention="craig",
        joint_types=[kind],
        position_limits=[limits],
        joint_angles=[home],
    )
    np.testing.assert_allclose(robot.display_ranges, [expected])
    np.testing.assert_array_equal(robot.position_limits, [limits])  # as declared, for physics


def test_robot_without_limits_has_display_ranges() -> None:
    robot = SerialRobot(
        dh_params=[[0, 0, 0, 0.2]] * 2,
        dh_convention="craig",
        joint_types=["revolute", "prismatic"],
    )
    np.testing.assert_allclose(robot.display_ranges, [[-np.pi, np.pi], [-1.0, 1.0]])


@pytest.mark.parametrize(
    ("coupling", "limits", "expected"),
    [
        # The coupled joint reaches its limit before the driving one does.
        ({"ratio": 2.0}, [[-2, 2], [-1, 3]], [[-0.5, 1.5], [-1, 3]]),
        ({"ratio": -0.5, "offset": 0.2}, [[-2, 2], [0, 1]], [[-1.6, 0.4], [0, 1]]),
        # A joint without limits follows over the whole range of the driving joint, and vice versa.
        ({"ratio": 3.0}, [[-2, 2], [-INF, INF]], [[-2, 2], [-6, 6]]),
        ({"ratio": 3.0}, [[-INF, INF], [-6, 3]], [[-2, 1], [-6, 3]]),
        ({"ratio": 1.0}, None, [[-np.pi, np.pi]] * 2),
        # Limits that leave no range are invalid.
        ({"ratio": -1.0}, [[0, 1], [0, 1]], [[0, 1], [-1, 0]]),
        ({"ratio": 1.0}, [[0, 1], [2, 3]], [[0, 1], [0, 1]]),
    ],
)
def test_driving_joint_respects_the_limits_of_its_coupled_joints(
    coupling: dict[str, float], limits: object, expected: list[list[float]]
) -> None:
    robot = SerialRobot(
        dh_params=[[0, 0, 0, 0.2]] * 2, dh_convention="craig", position_limits=limits,
        couplings={"J2": {"to": "J1", **coupling}},
    )  # fmt: skip
    np.testing.assert_allclose(robot.display_ranges, expected, atol=1e-12)
    if limits is not None and np.isfinite(limits).all():
        np.testing.assert_allclose(independent_limits(robot), expected[:1], atol=1e-12)
    for t in range(20):
        q = SineMotion(robot).at(float(t))[0]
        assert (q >= robot.display_ranges[:, 0]).all() and (q <= robot.display_ranges[:, 1]).all()


def test_placeholder_limit_does_not_extend_the_reach() -> None:
    table = {"dh_params": [[0, 0, 0, 0.2]], "dh_convention": "craig", "joint_types": ["prismatic"]}
    free = SerialRobot(**table)
    robot = SerialRobot(**table, position_limits=[[-1e6, 1e6]])
    assert robot.reach == free.reach
    np.testing.assert_array_equal(robot.strokes, [0.0])


def test_example_motions_of_continuous_joints_are_smooth_and_finite(tmp_path: Path) -> None:
    (robot,) = load_scene(gen3_like(tmp_path)).robots.values()
    motion, step = SineMotion(robot), 1e-5
    assert np.ptp([motion.at(t)[0] for t in range(10)], axis=0).min() > 0.3  # every joint moves
    for t in (0.0, 1.3, 20.0):
        before, now, after = (motion.at(t + k * step)[0] for k in (-1, 0, 1))
        assert (np.abs(now) <= np.where(np.arange(7) % 2 == 0, np.pi, 2.4)).all()
        np.testing.assert_allclose((after - before) / (2 * step), motion.at(t)[1], atol=1e-6)


def test_sliders_and_start_poses_are_within_the_ranges_but_joints_are_free(
    tmp_path: Path,
) -> None:
    (robot,) = load_scene(gen3_like(tmp_path)).robots.values()
    goal = JointGoal(robot, robot.home)
    assert goal.range_of(0) == (-np.pi, np.pi)
    assert goal.range_of(1) == (-2.4, 2.4)
    goal.set_joint(0, 9.0)  # typed: there is no limit
    assert goal.angles[0] == 9.0
    limits = independent_limits(robot)
    assert limits is not None and np.isinf(limits[0]).all()
    pose = bent_pose(robot)
    assert ((robot.display_ranges[:, 0] <= pose) & (pose <= robot.display_ranges[:, 1])).all()


@pytest.mark.extensions
@pytest.mark.parametrize("action", ["torque", "impedance"])
def test_learning_environment_starts_within_finite_spaces(tmp_path: Path, action: str) -> None:
    from sero_mj.extensions.learning.gymnasium_env import GymnasiumEnvironment
    from sero_mj.extensions.learning.make import make_environment

    environment = make_environment(f"{gen3_like(tmp_path)}/reach", action=action, time_limit=0.2)
    starts = np.array([environment.reset().observation["joint_angles"] for _ in range(20)])
    ranges = environment.robot.display_ranges
    assert (starts >= ranges[:, 0]).all() and (starts <= ranges[:, 1]).all()
    assert np.ptp(starts[:, 0]) > np.pi  # of a range of two
    plain = GymnasiumEnvironment(environment)
    for space in plain.observation_space.spaces.values():
        assert np.isfinite(space.low).all() and np.isfinite(space.high).all()
    observation, _ = plain.reset(seed=1)
    for _ in range(3):
        observation, reward, *_ = plain.step(np.ones(7, np.float32))
        assert plain.observation_space.contains(observation) and 0.0 <= reward <= 1.0


@pytest.mark.extensions
def test_continuous_joint_is_observed_beyond_its_range(tmp_path: Path) -> None:
    from sero_mj.extensions.learning.make import make_environment

    environment = make_environment(
        f"{gen3_like(tmp_path)}/hold", start=[5.0, 0, 0, 0, 0, 0, 0], time_limit=0.2
    )
    assert environment.reset().observation["joint_angles"][0] == pytest.approx(5.0, abs=0.05)


@pytest.mark.extensions
def test_joint_without_torque_limit_is_named_for_torque_actions(tmp_path: Path) -> None:
    from sero_mj.extensions.learning.make import make_environment

    path = gen3_like(tmp_path, effort="")
    with pytest.raises(DeclarationError) as error:
        make_environment(f"{path}/reach", action="torque")
    (problem,) = error.value.problems
    assert problem.key == "robots.gen3.torque_limits" and "j7" in problem.message
    spec = make_environment(f"{path}/reach", action="impedance").action_spec()
    assert np.isfinite(spec.maximum).all()
