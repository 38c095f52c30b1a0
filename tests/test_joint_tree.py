"""Robots whose joints have their own frames and may branch, against the compiled model."""

import mujoco
import numpy as np
import pytest
from conftest import raises_with
from hypothesis import given
from hypothesis import strategies as st

from sero_mj.base.errors import DeclarationError, Problem
from sero_mj.base.frames import frame, rotation_from_rpy
from sero_mj.data.drive.place import Placer
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.double import Double
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.robots.kinematics.joint_tree import JointFrames

ORDER = "joints in depth-first order"
BASE = frame(rotation_from_rpy([0.2, -0.3, 0.5]), [0.3, -0.1, 0.4])


def random_frame(rng, scale=0.3):
    return frame(rotation_from_rpy(rng.uniform(-2, 2, 3)), rng.uniform(-scale, scale, 3))


def random_parents(rng, names):
    """Depth-first: each joint is on the base, or on the path to the previous joint."""
    parents, branch = [], ["base"]
    for name in names:
        at = rng.integers(len(branch))
        parents.append(branch[at])
        branch = [*branch[: at + 1], name]
    return parents


def tree_robot(seed, n=7, **fields):
    rng = np.random.default_rng(seed)
    names = [f"q{i}" for i in range(n)]
    kinds = rng.choice(["revolute", "revolute", "prismatic"], n).tolist()
    given = {
        "name": "tree", "joint_frames": [random_frame(rng) for _ in names], "joint_names": names,
        "joint_types": kinds, "parents": random_parents(rng, names), "base_frame": BASE,
        "flange_on": names[rng.integers(n)], "flange_frame": random_frame(rng),
    }  # fmt: skip
    return SerialRobot(**{**given, **fields})


def values_of(robot, seed):
    return np.random.default_rng(seed + 1).uniform(-1.5, 1.5, robot.n)


def by_hand(robot, q):
    """Returns T_world_i by the definition of joint frames, link by link."""
    frames = [robot.base_frame]
    for i in range(robot.n):
        moved = np.eye(4)
        if robot.types[i] == "revolute":
            c, s = np.cos(q[i]), np.sin(q[i])
            moved[:2, :2] = [[c, -s], [s, c]]
        else:
            moved[2, 3] = q[i]
        parent = 0 if robot.parents[i] == "base" else robot.names.index(robot.parents[i]) + 1
        frames.append(frames[parent] @ robot.joint_frames[i] @ moved)
    return np.array(frames)


@given(seed=st.integers(0, 10**6), mirrored=st.booleans())
def test_frames_and_flange_equal_those_of_the_compiled_model(seed, mirrored):
    robot = tree_robot(seed, mirrored=mirrored)
    world, q = World(Scene(robots=[robot])), values_of(robot, seed)
    data, part = world.make_data(), world.robots["tree"]
    data.qpos[part.qpos] = q
    mujoco.mj_forward(world.model, data)
    found = robot.kinematics.frames(q, robot.base_frame)
    np.testing.assert_allclose(data.xpos[part.bodies], found[:, :3, 3], atol=1e-9)
    rotations = data.xmat[part.bodies].reshape(-1, 3, 3)
    np.testing.assert_allclose(rotations, found[:, :3, :3], atol=1e-9)
    flange = world.frame(data, "tree/flange")
    expected = robot.base_frame @ robot.fwd_kin_base_to_flange(q)
    np.testing.assert_allclose(flange, expected, atol=1e-9)
    if not mirrored:
        np.testing.assert_allclose(found, by_hand(robot, q), atol=1e-12)
    linear, angular = np.zeros((2, 3, world.model.nv))
    mujoco.mj_jac(world.model, data, linear, angular, flange[:3, 3], part.flange_body)
    J = robot.kinematics.jacobian(q, robot.base_frame, robot.T_n_flange, robot.flange_link)
    np.testing.assert_allclose(J, np.vstack([linear, angular])[:, part.dofs], atol=1e-9)


def test_mirrored_tree_is_the_mirror_image_in_its_base():
    S = np.diag([1.0, -1.0, 1.0, 1.0])
    robot, q = tree_robot(5), values_of(tree_robot(5), 5)
    mirrored = robot.model_copy(update={"mirrored": True})
    np.testing.assert_allclose(
        mirrored.kinematics.frames(q), S @ robot.kinematics.frames(q) @ S, atol=1e-12
    )


def test_craig_table_equals_the_chain_of_its_joint_frames():
    rows = np.random.default_rng(3).uniform(-1, 1, (6, 4))
    root = random_frame(np.random.default_rng(4))
    table = SerialRobot(dh_convention="craig", dh_params=rows, dh_base_frame=root)
    fixed = table.kinematics.link_transforms(np.zeros(6))
    chain = SerialRobot(joint_frames=fixed)
    q = values_of(chain, 3)
    np.testing.assert_allclose(table.kinematics.frames(q), chain.kinematics.frames(q), atol=1e-12)
    np.testing.assert_allclose(
        table.kinematics.jacobian(q), chain.kinematics.jacobian(q), atol=1e-12
    )
    assert chain.dh is None and table.dh is not None


@pytest.mark.parametrize("convention", ["craig", "standard"])
def test_table_can_have_a_base_frame_and_branches(convention):
    root, rows = random_frame(np.random.default_rng(8)), [[0.5, 0.2, 0.1, 0.3]] * 4
    robot = SerialRobot(
        name="tree", dh_convention=convention, dh_params=rows, dh_base_frame=root,
        parents=["base", "J1", "base", "J3"], base_frame=BASE,
    )  # fmt: skip
    world, q = World(Scene(robots=[robot])), np.array([0.3, -0.4, 0.5, 0.6])
    data, part = world.make_data(), world.robots["tree"]
    data.qpos[part.qpos] = q
    mujoco.mj_forward(world.model, data)
    frames = robot.kinematics.frames(q, BASE)
    np.testing.assert_allclose(data.xpos[part.bodies], frames[:, :3, 3], atol=1e-9)
    links = robot.kinematics.transforms(q)
    np.testing.assert_allclose(frames[3], BASE @ root @ links[2], atol=1e-12)
    np.testing.assert_allclose(frames[4], BASE @ root @ links[2] @ links[3], atol=1e-12)
    axes, points = robot.kinematics.joint_axes(frames)
    joints = world.model.dof_jntid[part.dofs]
    np.testing.assert_allclose(axes, data.xaxis[joints], atol=1e-9)
    off_axis = np.cross(points - data.xanchor[joints], axes)
    np.testing.assert_allclose(off_axis, 0.0, atol=1e-9)


def test_gravity_torques_of_a_tree_follow_from_its_masses():
    rng = np.random.default_rng(11)
    masses = rng.uniform(0.5, 3, 8)
    centers = rng.uniform(-0.1, 0.1, (8, 3))
    dynamics = {"masses": masses, "centers_of_mass": centers, "inertias": [[0.1] * 3 + [0] * 3] * 8}
    robot = tree_robot(11, dynamics=dynamics)
    world, q = World(Scene(robots=[robot]), dynamic=True), values_of(robot, 11)
    data, part = world.make_data(), world.robots["tree"]
    data.qpos[part.qpos] = q
    mujoco.mj_forward(world.model, data)
    frames, table = robot.kinematics.frames(q, robot.base_frame), robot.kinematics
    expected = np.zeros(7)
    for link in range(1, 8):
        at = np.eye(4)
        at[:3, 3] = centers[link]
        J = table.jacobian(q, robot.base_frame, at, link)
        expected += J[2] * masses[link] * 9.81
    np.testing.assert_allclose(data.qfrc_bias[part.dofs], expected, atol=1e-9)
    assert frames.shape == (8, 4, 4)


def test_links_without_mass_and_joints_without_limits_can_be_simulated():
    inf = np.inf
    robot = SerialRobot(
        name="tree", joint_frames=[{"xyz": [0, 0, 0.1]}, {"xyz": [0.2, 0, 0]}],
        position_limits=[[-inf, inf], [-1, inf]], velocity_limits=[inf, 2.0],
        torque_limits=[inf, 5.0],
        dynamics={"masses": [1, 0, 1], "centers_of_mass": [[0, 0, 0]] * 3,
                  "inertias": [[0.1, 0.1, 0.1, 0, 0, 0], [0] * 6, [0.1, 0.1, 0.1, 0, 0, 0]]},
    )  # fmt: skip
    known = robot_dynamics(robot)
    assert known.masses.tolist() == [1, pytest.approx(0, abs=1e-5), 1]
    assert np.isfinite(known.motor_inertias).all() and (known.motor_inertias > 0).all()
    world = World(Scene(robots=[robot]), dynamic=True)
    assert world.model.jnt_limited.tolist() == [0, 1]
    data = world.make_data()
    for _ in range(100):
        mujoco.mj_step(world.model, data)
    assert np.isfinite(data.qpos).all()


def test_links_have_shapes_and_meshes_in_their_own_frames():
    at = frame(rotation_from_rpy([0, 0, 0.3]), [0.1, 0.2, 0.3])
    box = {"shape": "box", "size": [0.1, 0.2, 0.4], "frame": at, "color": "red"}
    tube = {"shape": "cylinder", "size": [0.05, 0.3]}
    robot = SerialRobot(
        name="tree", joint_frames=[np.eye(4)] * 2, filenames=["", box, [box, tube]],
        colors={"red": [1, 0, 0, 1]}, collisions=["", tube, ""],
    )  # fmt: skip
    world = World(Scene(robots=[robot], floor=False))
    model = world.model
    assert model.ngeom == 3
    np.testing.assert_allclose(model.geom_size[0], [0.05, 0.1, 0.2])
    np.testing.assert_allclose(model.geom_pos[0], [0.1, 0.2, 0.3])
    np.testing.assert_allclose(model.geom_rgba[0], [1, 0, 0, 1])
    np.testing.assert_allclose(model.geom_size[2, :2], [0.05, 0.15])
    dynamic = World(Scene(robots=[robot], floor=False), dynamic=True).model
    touching = (dynamic.geom_contype | dynamic.geom_conaffinity) > 0
    assert touching.sum() == 1
    np.testing.assert_allclose(dynamic.geom_size[touching][0, :2], [0.05, 0.15])


def test_doubles_of_trees_are_at_their_joint_angles():
    robot = tree_robot(2)
    scene = Scene(robots=[robot], doubles=[Double(name="goal", of="tree")])
    world, q = World(scene), values_of(robot, 2)
    data = world.make_data()
    world.set_input(data, "goal.joint_angles", q)
    Placer(world).place(data)
    frames = robot.kinematics.frames(q, robot.base_frame)
    mujoco.mj_kinematics(world.model, data)
    bodies = world.doubles["goal"].bodies[0][1:]  # the base coincides and is hidden
    np.testing.assert_allclose(data.xpos[bodies], frames[1:, :3, 3], atol=1e-9)


def test_fields_of_a_tree_can_be_set_one_by_one():
    robot = tree_robot(1)
    robot.base_frame = {"xyz": [0, 0, 1.5]}
    robot.show_axes = True
    assert robot.base_frame[2, 3] == 1.5 and robot.show_axes and robot.n == 7
    with raises_with(reason="found dh_base_frame with joint_frames; expected only one of them"):
        robot.dh_base_frame = {"xyz": [0, 0, 1]}


def test_arrows_fit_the_links():
    thick = {"shape": "cylinder", "size": [0.2, 0.3]}
    thin = {"shape": "cylinder", "size": [0.02, 0.3], "frame": {"xyz": [0, 0, 0.15]}}
    frames = [{"xyz": [0, 0, 0.3]}, {"xyz": [0, 0, 0.6]}]
    robot = SerialRobot(
        name="arm", joint_frames=frames, filenames=[thick, thick, thin], fit_arrows=True,
        show_arrows=True,
    )  # fmt: skip
    radius = World(Scene(robots=[robot])).joints.arrow_radius
    assert 0.199 < radius[0] < 0.35 and 0.02 < radius[1] < 0.6 * radius[0]


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        (
            {"joint_frames": [np.eye(4)] * 2, "parents": ["base"]},
            Problem("parents", found=1, of="entries", expected="2, one per frame of joint_frames"),
        ),
        (
            {"joint_frames": [np.eye(4)] * 2, "parents": ["base", "J9"]},
            Problem("parents.1", "no joint", found="J9", available=["J1", "J2", "base"]),
        ),
        (
            {"joint_frames": [np.eye(4)] * 2, "parents": ["J2", "base"]},
            Problem(
                "parents.0", "J1 does not continue the branch of its parent J2", expected=ORDER
            ),
        ),
        (
            {"joint_frames": [np.eye(4)] * 3, "parents": ["base", "base", "J1"]},
            Problem(
                "parents.2", "J3 does not continue the branch of its parent J1", expected=ORDER
            ),
        ),
        (
            {"joint_frames": [np.eye(4)], "dh_params": [[0, 0, 0, 0]]},
            Problem(reason="found dh_params with joint_frames; expected only one of them"),
        ),
        ({"dh_convention": "none"}, Problem("dh_convention", "found 'none' without joint_frames",
                                            expected="'craig' or 'standard'")),
        ({"joint_frames": []}, Problem("joint_frames", found=0, of="frames",
                                       expected="1 to 128, one per joint")),
        (
            {"joint_frames": [{"xyz": [0, 0]}]},
            Problem("joint_frames", "joint 1: 'xyz' has 2 numbers; expected 3"),
        ),
        (
            {"joint_frames": [np.eye(4)], "flange_on": "J2"},
            Problem("flange_on", "no joint", found="J2", available=["J1"]),
        ),
        (
            {"joint_frames": [np.eye(4)], "filenames": ["", {"shape": "box", "size": [1, 1]}]},
            Problem("filenames.1.0",
                    "size of a box: found [1.0, 1.0]; expected positive length x, length y, "
                    "length z in m"),
        ),
        (
            {"joint_frames": [np.eye(4)], "filenames": ["", {"color": "red"}]},
            Problem("filenames.1.0", "found neither file nor shape; expected one of them"),
        ),
    ],
)  # fmt: skip
def test_invalid_trees_are_rejected(fields, problem):
    with pytest.raises(DeclarationError) as caught:
        SerialRobot(**fields)
    assert caught.value.problems == [problem]


def test_batched_poses_equal_single_ones():
    robot = tree_robot(4)
    q = np.random.default_rng(0).uniform(-1, 1, (5, 2, 7))
    many = robot.kinematics.frames(q)
    assert isinstance(robot.kinematics, JointFrames) and many.shape == (5, 2, 8, 4, 4)
    np.testing.assert_allclose(many[3, 1], robot.kinematics.frames(q[3, 1]), atol=1e-14)
