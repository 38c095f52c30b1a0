"""Mirrored robots: kinematics, dynamics, shapes and meshes are those of the image in a mirror."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from sero_mj import DeclarationError, Plant, Scene, SerialRobot, World
from sero_mj.base.frames import frame, rotation_from_rpy
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.viewer.decor.quantities import jacobian

S = np.diag([1.0, -1.0, 1.0, 1.0])
BASE = frame(rotation_from_rpy(np.array([0.9, 0.2, -0.4])), np.array([0.1, 0.3, 0.5]))
FLANGE = frame(rotation_from_rpy(np.array([0.3, -0.6, 0.2])), np.array([0.1, 0.2, 0.3]))
LINKS = 4


def make(convention: str, *, mirrored: bool, **fields: Any) -> SerialRobot:
    """A robot of three revolute joints and a sliding one without any symmetry of its own."""
    rng = np.random.default_rng(5)
    return SerialRobot(
        name="r",
        dh_convention=convention,
        dh_params=rng.uniform(-0.5, 0.5, (LINKS, 4)) + np.array([0.7, 0.3, 0.4, 0.2]),
        joint_types=["revolute", "revolute", "prismatic", "revolute"],
        position_limits=[[-2, 2], [-2, 2], [0, 0.4], [-2, 2]],
        flange_frame=frame(
            rotation_from_rpy(np.array([0.3, -0.6, 0.2])), np.array([0.1, 0.2, 0.3])
        ),
        offsets_to_center_of_joints=rng.uniform(-0.2, 0.2, (LINKS, 3)),
        base_frame=S @ BASE @ S if mirrored else BASE,
        mirrored=mirrored,
        **fields,
    )


def pair(convention: str, **fields: Any) -> tuple[SerialRobot, SerialRobot]:
    return tuple(make(convention, mirrored=mirrored, **fields) for mirrored in (False, True))  # type: ignore[return-value]


def angles(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform([-2, -2, 0, -2], [2, 2, 0.4, 2], LINKS)


@pytest.mark.parametrize("convention", ["craig", "standard"])
def test_all_frames_of_the_model_are_mirror_images_at_equal_joint_values(convention: str) -> None:
    right, left = pair(convention)
    worlds = [World(Scene(robots=[robot])) for robot in (right, left)]
    datas = [world.make_data() for world in worlds]
    for seed in range(50):
        q = angles(seed)
        for world, data in zip(worlds, datas, strict=True):
            world.set_input(data, "r.joint_angles", q)
            mujoco.mj_kinematics(world.model, data)
        for name in worlds[0].frames.names:
            ours, theirs = (w.frame(d, name) for w, d in zip(worlds, datas, strict=True))
            np.testing.assert_allclose(theirs, S @ ours @ S, atol=1e-13)
        np.testing.assert_allclose(  # and numpy agrees with the model
            worlds[1].frame(datas[1], "r/flange"),
            left.base_frame @ left.fwd_kin_base_to_flange(q),
            atol=1e-13,
        )
        sites = [world.joints.centre_site for world in worlds]
        ours, theirs = (d.site_xpos[s] for d, s in zip(datas, sites, strict=True))
        np.testing.assert_allclose(theirs, ours * [1, -1, 1], atol=1e-13)


@pytest.mark.parametrize("convention", ["craig", "standard"])
def test_jacobian_equals_finite_differences(convention: str) -> None:
    left = make(convention, mirrored=True)
    q, step = angles(3), 1e-6 * np.eye(LINKS)
    J = left.dh.jacobian(q, left.base_frame, left.T_n_flange)
    for i, e in enumerate(step):
        after, before = (left.base_frame @ left.fwd_kin_base_to_flange(q + s * e) for s in (1, -1))
        np.testing.assert_allclose((after - before)[:3, 3] / 2e-6, J[:3, i], atol=1e-8)
        spin = (after - before)[:3, :3] / 2e-6 @ before[:3, :3].T
        np.testing.assert_allclose([spin[2, 1], spin[0, 2], spin[1, 0]], J[3:, i], atol=1e-5)
    world = World(Scene(robots=[left]))
    data = world.make_data()
    world.set_input(data, "r.joint_angles", q)
    mujoco.mj_kinematics(world.model, data)
    part = world.robots["r"]
    scaled = jacobian(world, data, part) * np.repeat([part.reach, 1.0], 3)[:, None]
    np.testing.assert_allclose(scaled, J, atol=1e-12)  # the sites about which arrows turn


@pytest.mark.parametrize("frames", ["dh", "zero_pose"])
@pytest.mark.parametrize("convention", ["craig", "standard"])
def test_mass_and_gravity_torques_are_equal(convention: str, frames: str) -> None:
    rng = np.random.default_rng(7)
    dynamics = {
        "frames": frames,
        "masses": rng.uniform(1, 4, LINKS + 1),
        "centers_of_mass": rng.uniform(-0.2, 0.2, (LINKS + 1, 3)),
        "inertias": [[0.03, 0.04, 0.05, 0.004, -0.003, 0.002]] * (LINKS + 1),
        "viscous_friction": np.zeros(LINKS),
        "coulomb_friction": np.zeros(LINKS),
    }
    right, left = pair(convention, dynamics=dynamics)
    assert robot_dynamics(left).masses.sum() == robot_dynamics(right).masses.sum()
    plants = [Plant(World(Scene(robots=[r], floor=False), dynamic=True)) for r in (right, left)]
    for seed in range(10):
        for plant in plants:
            plant.reset(angles(seed))
        np.testing.assert_allclose(plants[1].measured[2], plants[0].measured[2], atol=1e-11)
    start = plants[0].measured[0].copy()
    for _ in range(200):  # they fall alike, so their inertia is alike as well
        for plant in plants:
            plant.step(np.zeros(LINKS))
    np.testing.assert_allclose(plants[1].measured, plants[0].measured, atol=1e-9)
    assert np.abs(plants[0].measured[0] - start).max() > 0.01


def test_estimated_masses_of_shapes_and_hulls_are_mirrored() -> None:
    for fields in ({"model": "lwr"}, {}):
        if fields:
            right, left = (
                SerialRobot.from_model("lwr", mirrored=m, dynamics={"masses": None,
                "centers_of_mass": None, "inertias": None, "frames": "dh", "frame_origins": None})
                for m in (False, True)
            )  # fmt: skip
        else:
            right, left = pair("craig")
        ours, theirs = robot_dynamics(right), robot_dynamics(left)
        assert "masses" in ours.estimated
        np.testing.assert_allclose(theirs.masses, ours.masses)
        np.testing.assert_allclose(theirs.centers, ours.centers * [1, -1, 1])
        mirror = S[:3, :3]
        np.testing.assert_allclose(theirs.tensors, mirror @ ours.tensors @ mirror)


def mesh_middle(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> np.ndarray:
    mesh = model.geom_dataid[geom]
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    corners = data.geom_xmat[geom].reshape(3, 3) @ model.mesh_vert[first : first + count].T
    return np.asarray(corners.mean(axis=1) + data.geom_xpos[geom])


def volume(model: mujoco.MjModel, mesh: int) -> float:
    """By the divergence theorem: positive where faces turn outwards."""
    first, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    faces = model.mesh_face[first : first + count] + model.mesh_vertadr[mesh]
    a, b, c = (model.mesh_vert[faces[:, k]].astype(float) for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@pytest.mark.parametrize("fields", [{}, {"mesh": True}])
def test_geoms_are_mirror_images(fields: dict[str, bool]) -> None:
    if fields:
        base = {False: BASE, True: S @ BASE @ S}
        right, left = (
            SerialRobot.from_model("lwr", mirrored=m, base_frame=base[m], name="r")
            for m in (False, True)
        )
        q = np.linspace(-1, 1, 7)
    else:
        right, left = pair("standard")
        q = angles(1)
    found = []
    for robot in (right, left):
        world = World(Scene(robots=[robot], floor=False))
        data = world.make_data()
        world.set_input(data, "r.joint_angles", q)
        mujoco.mj_kinematics(world.model, data)
        found.append(data.geom_xpos.copy())
        if fields:  # the middle of all corners; faces are seen from outside
            found[-1] = np.array([mesh_middle(world.model, data, g) for g in range(len(found[-1]))])
            assert all(volume(world.model, mesh) > 0 for mesh in range(world.model.nmesh))
    np.testing.assert_allclose(found[1], found[0] * [1, -1, 1], atol=1e-6)


def test_mirrored_hand_on_a_mirrored_arm_mirrors_the_hand_on_the_arm() -> None:
    worlds = []
    for mirrored in (False, True):
        at = frame(rotation_from_rpy(np.array([0.5, 0.1, 0.2])), np.array([0.02, 0.03, 0.04]))
        tool = {"name": "grip", "shape": "axes", "frame": at}
        arm = make("craig", mirrored=mirrored, children=[tool])
        hand = SerialRobot(
            name="hand", dh_convention="standard", dh_params=[[0.4, 0.1, 0.2, 0.3]],
            mount="r/grip", mirrored=mirrored, base_frame=S @ at @ S if mirrored else at,
        )  # fmt: skip
        world = World(Scene(robots=[arm, hand]))
        data = world.make_data()
        world.set_input(data, "r.joint_angles", angles(9))
        world.set_input(data, "hand.joint_angles", [0.7])
        mujoco.mj_kinematics(world.model, data)
        worlds.append(world.frame(data, "hand/flange"))
    np.testing.assert_allclose(worlds[1], S @ worlds[0] @ S, atol=1e-13)


def test_mjcf_object_cannot_be_mirrored() -> None:
    child = {"name": "t", "mjcf": "<mujoco><worldbody><geom size='.1'/></worldbody></mujoco>"}
    with pytest.raises(DeclarationError) as caught:
        make("craig", mirrored=True, children=[child])
    assert str(caught.value) == (
        "mirrored: the child 't' is from MJCF or URDF, and cannot be mirrored; "
        "expected only shapes and meshes as children"
    )
