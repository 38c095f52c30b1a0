"""Well-known robots: published poses and dynamics, and a second computation of each."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from newton_euler import inverse_dynamics
from poses import chain, move, rot

from sero_mj.load import load_scene
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene

HALF_PI, QUARTER = math.pi / 2, math.pi / 4
NAMES = ["puma560", "panda", "scara", "stanford", "ur5e", "ur10e", "fr3", "iiwa14"]
SHAPED = ["panda", "fr3", "iiwa14", "ur5e", "ur10e"]  # with meshes
QN = np.array([0, math.pi / 4, -math.pi, 0, math.pi / 4, 0])  # the Puma's nominal pose


def puma(q):
    """Craig's table of the Puma (ROBOTS.md 4.2, 4): the same frames in the other convention."""
    rows = [
        (0, 0, 0.67183), (HALF_PI, 0, 0), (0, 0.4318, 0.15005),
        (-HALF_PI, 0.0203, 0.4318), (HALF_PI, 0, 0), (-HALF_PI, 0, 0),
    ]  # fmt: skip
    steps = [
        (rot(0, al), move(a), rot(2, t), move(z=d)) for (al, a, d), t in zip(rows, q, strict=True)
    ]
    return chain(*(step for row in steps for step in row))


def panda(q):
    """The bodies of mujoco_menagerie's panda.xml: position and a rotation about x by quat."""
    bodies = [
        (0, 0, 0.333, 0), (0, 0, 0, -HALF_PI), (0, -0.316, 0, HALF_PI), (0.0825, 0, 0, HALF_PI),
        (-0.0825, 0.384, 0, -HALF_PI), (0, 0, 0, HALF_PI), (0.088, 0, 0, HALF_PI),
    ]  # fmt: skip
    steps = [(move(*at[:3]), rot(0, at[3]), rot(2, t)) for at, t in zip(bodies, q, strict=True)]
    return chain(*(step for body in steps for step in body), move(z=0.107))


def universal(d1, a2, a3, d4, d5, d6):
    """The frames of a UR from its published standard table."""

    def frames(q):
        rows = [(0, d1, HALF_PI), (a2, 0, 0), (a3, 0, 0), (0, d4, HALF_PI), (0, d5, -HALF_PI),
                (0, d6, 0)]  # fmt: skip
        steps = [(rot(2, t), move(a, 0, d), rot(0, al))
                 for (a, d, al), t in zip(rows, q, strict=True)]  # fmt: skip
        return chain(*(step for row in steps for step in row))

    return frames


# Universal Robots, "DH parameters for calculations of kinematics and dynamics".
UR5E = universal(0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996)
UR10E = universal(0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655)


def iiwa(q):
    """The arm in KUKA's drawing: alternating rotations about vertical and horizontal axes."""
    return chain(
        move(z=0.36), rot(2, q[0]), rot(1, q[1]), move(z=0.42), rot(2, q[2]), rot(1, -q[3]),
        move(z=0.4), rot(2, q[4]), rot(1, q[5]), move(z=0.152), rot(2, q[6]),
    )  # fmt: skip


def scara(q):
    """A planar arm of two links with a flange that points down."""
    a, b = q[0], q[0] + q[1]
    x = 0.325 * math.cos(a) + 0.275 * math.cos(b)
    y = 0.325 * math.sin(a) + 0.275 * math.sin(b)
    return chain(move(x, y, 0.387 - q[2]), rot(2, b), rot(0, math.pi), rot(2, q[3]))


def stanford(q):
    """Spong, Hutchinson, Vidyasagar, Robot Modeling and Control, example 3.5, position alone.

    Its fourth angle is zero where this table's is at pi/2.
    """
    c, s = np.cos(q), np.sin(q)
    c4, s4 = s[3], -c[3]
    d1, d2, d3, d6 = 0.412, 0.154, q[2], 0.263
    T = np.full((4, 4), np.nan)
    T[:3, 3] = [
        c[0] * s[1] * d3 - s[0] * d2
        + d6 * (c[0] * c[1] * c4 * s[4] + c[0] * c[4] * s[1] - s[0] * s4 * s[4]),
        s[0] * s[1] * d3 + c[0] * d2
        + d6 * (c[0] * s4 * s[4] + c[1] * c4 * s[0] * s[4] + c[4] * s[0] * s[1]),
        d1 + c[1] * d3 + d6 * (c[1] * c[4] - c4 * s[1] * s[4]),
    ]  # fmt: skip
    return T


BY_HAND = {
    "puma560": puma, "panda": panda, "scara": scara, "stanford": stanford, "ur5e": UR5E,
    "ur10e": UR10E, "fr3": panda, "iiwa14": iiwa,
}  # fmt: skip


@pytest.mark.parametrize(("name", "by_hand"), BY_HAND.items())
def test_table_and_model_agree_with_a_second_computation_at_random_poses(name, by_hand):
    robot = SerialRobot.from_model(name)
    world = World(Scene(robots=[robot]))
    data = world.make_data()
    low, high = robot.position_limits.T
    for q in np.random.default_rng(5).uniform(low, high, (40, robot.n)):
        world.set_input(data, f"{name}.joint_angles", q)
        mujoco.mj_kinematics(world.model, data)
        expected = by_hand(q)
        known = ~np.isnan(expected)
        for pose in (
            robot.fwd_kin_base_to_flange(q),
            world.fwd_kin_base_to_flange(data, name),
        ):
            np.testing.assert_allclose(pose[known], expected[known], atol=1e-12)


@pytest.mark.parametrize(
    ("name", "q", "position", "rotation"),
    [
        # petercorke/robotics-toolbox-python, docs/notebooks/kinematics.ipynb
        ("puma560", QN, [0.5963, -0.15005, 0.65748], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]),
        # petercorke/robotics-toolbox-matlab, issue 125: 0.926 m; ROBOTS.md 4.2, 6
        ("panda", [0] * 7, [0.088, 0, 0.926], np.diag([1, -1, -1])),
        # Franka's ready pose, as frankarobotics/libfranka's examples begin; FD's kinematics.yaml.
        (
            "fr3",
            [0, -QUARTER, 0, -3 * QUARTER, 0, HALF_PI, QUARTER],
            [0.30689, 0, 0.59028],
            np.array([[1, -1, 0], [-1, -1, 0], [0, 0, -math.sqrt(2)]]) / math.sqrt(2),
        ),
        ("iiwa14", [0] * 7, [0, 0, 1.332], np.eye(3)),  # KUKA: 360 + 420 + 400 mm, and the flange
        # UR's table at zero: x = a2 + a3, y = -(d4 + d6), z = d1 - d5.
        ("ur5e", [0] * 6, [-0.8172, -0.2329, 0.0628], [[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
        ("ur10e", [0] * 6, [-1.18425, -0.2907, 0.06085], [[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
        # Stretched, it reaches 600 mm, as its name says. Its quill moves 210 mm.
        ("scara", [0] * 4, [0.6, 0, 0.387], np.diag([1, -1, -1])),
        ("scara", [0, 0, 0.21, 0], [0.6, 0, 0.177], np.diag([1, -1, -1])),
        # The zero pose of the standard and the modified table in robotics-toolbox-matlab.
        ("stanford", [0] * 6, [0, 0.154, 0.675], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
    ],
)
def test_flange_is_at_the_published_pose(name, q, position, rotation):
    robot = SerialRobot.from_model(name)
    pose = robot.fwd_kin_base_to_flange(q)
    np.testing.assert_allclose(pose[:3, 3], position, atol=5e-5)
    np.testing.assert_allclose(pose[:3, :3], rotation, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_shipped_pose_is_within_the_limits(name):
    robot = SerialRobot.from_model(name)
    low, high = robot.position_limits.T
    assert (robot.home >= low).all() and (robot.home <= high).all()
    assert "prismatic" in robot.types or name not in ("scara", "stanford")


# petercorke/robotics-toolbox-python, docs/notebooks/icra2021.ipynb and tests/test_DHRobot.py:
# gravity torques of the Puma at its nominal pose, Nm, and its inertia matrix there with motors, kg
# m2.
PUMA_GRAVITY = [0, 31.6398804, 6.03513802, 0, 0.0282528, 0]
PUMA_INERTIA = [
    [3.65937541, -0.404361246, 0.100613648, -2.51695583e-3, 0, 0],
    [-0.404361246, 4.41374193, 0.350890665, 0, 2.35951307e-3, 0],
    [0.100613648, 0.350890665, 0.937841575, 0, 1.48016639e-3, 0],
    [-2.51695583e-3, 0, 0, 0.192531706, 0, 2.82842712e-5],
    [0, 2.35951307e-3, 1.48016639e-3, 0, 0.171348452, 0],
    [0, 0, 0, 2.82842712e-5, 0, 0.194104506],
]


@pytest.fixture(scope="module")
def puma_world():
    world = World(Scene(robots=[SerialRobot.from_model("puma560")]), dynamic=True)
    data = world.make_data()
    world.set_input(data, "puma560.joint_angles", QN)
    mujoco.mj_forward(world.model, data)
    return world, data


def test_puma_gravity_torques_equal_the_published_ones(puma_world):
    _, data = puma_world
    np.testing.assert_allclose(data.qfrc_bias, PUMA_GRAVITY, atol=1e-6)
    robot = SerialRobot.from_model("puma560")
    by_hand = inverse_dynamics(robot, robot_dynamics(robot), QN)
    np.testing.assert_allclose(by_hand, PUMA_GRAVITY, atol=1e-6)


def test_puma_inertia_matrix_equals_the_published_one(puma_world):
    world, data = puma_world
    found = np.zeros((6, 6))
    mujoco.mj_fullM(world.model, data, found)
    # Joint 1 carries the tensor added to link 3 to make it physical, at most 0.00375 kg m2. Motor
    # inertias are rounded to 1e-5.
    tolerance = np.full((6, 6), 1e-5)
    tolerance[0, 0] = 0.0038
    assert (np.abs(found - PUMA_INERTIA) <= tolerance).all(), found - PUMA_INERTIA
    # Differs from the published value.
    assert found[0, 0] != pytest.approx(PUMA_INERTIA[0][0], abs=1e-4)


def test_puma_torques_of_a_motion_equal_the_published_ones(puma_world):
    # tests/test_DHRobot.py, test_rne: unit velocities and accelerations at the nominal pose, with
    # friction, minus gravity torques and the torques of motors and friction.
    robot = SerialRobot.from_model("puma560")
    published = np.array([29.1421, 56.5044, 16.3528, 1.26448, 1.12392, 0.519648])  # velocity 1
    ones = np.ones(6)
    dynamics = robot_dynamics(robot)
    links = inverse_dynamics(robot, dynamics, QN, velocities=ones)
    viscous = dynamics.viscous_friction
    # RTB uses the Coulomb friction of this direction (motors 1 and 3 rotate the other way). The
    # file has the mean of both directions.
    gears = np.array([62.6111, 107.815, 53.7063, 76.0364, 71.923, 76.686])
    one_way = gears * [0.395, 0.126, 0.132, 11.2e-3, 9.26e-3, 3.96e-3]
    np.testing.assert_allclose(links + viscous + one_way, published, atol=4e-3)
    other_way = gears * [0.435, 0.071, 0.105, 16.9e-3, 14.5e-3, 10.5e-3]
    np.testing.assert_allclose(dynamics.coulomb_friction, (one_way + other_way) / 2, rtol=1e-3)


def test_panda_gravity_torques_follow_from_its_masses():
    robot = SerialRobot.from_model("panda")
    world = World(Scene(robots=[robot]), dynamic=True)
    data = world.make_data()
    mujoco.mj_forward(world.model, data)
    dynamics = robot_dynamics(robot)

    # A second computation: the gradient of the potential energy by finite differences.
    def energy(q):
        T = robot.dh.frames(q)[1:]
        centers = T[:, :3, 3] + np.einsum("nij,nj->ni", T[:, :3, :3], dynamics.centers[1:])
        return 9.81 * dynamics.masses[1:] @ centers[:, 2]

    step = 1e-6 * np.eye(7)
    gradient = [(energy(robot.home + h) - energy(robot.home - h)) / 2e-6 for h in step]
    np.testing.assert_allclose(data.qfrc_bias, gradient, atol=1e-6)
    assert (np.abs(gradient) < robot.torque_limits).all()
    assert dynamics.masses[1:].sum() == pytest.approx(16.062132)


@pytest.mark.parametrize("name", SHAPED)
def test_meshes_begin_at_the_floor_and_end_at_the_flange(name):
    world = World(load_scene(name), dynamic=True)
    model, data = world.model, world.make_data()
    mujoco.mj_forward(model, data)
    assert not data.ncon  # in the shipped pose
    assert model.geom("floor").pos[2] == pytest.approx(0, abs=1e-6)
    part = world.robots[name]
    flange = world.fwd_kin_base_to_flange(data, name)
    along = []
    for geom in np.flatnonzero(
        (model.geom_bodyid == part.bodies[-1]) & (model.geom_dataid >= 0) & (model.geom_group < 3)
    ):
        mesh = model.geom_dataid[geom]
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        rotation = data.geom_xmat[geom].reshape(3, 3)
        points = model.mesh_vert[start : start + count] @ rotation.T + data.geom_xpos[geom]
        along.append((points - flange[:3, 3]) @ flange[:3, 2])
    assert np.concatenate(along).max() == pytest.approx(0, abs=2e-4)
