"""Parts of the DLR systems: tables, proportions, and the note that they are approximate."""

from __future__ import annotations

import importlib.util
import math
import re
import shutil
import subprocess
import sys

import mujoco
import numpy as np
import pytest
from conftest import sampled
from poses import chain, move, rot

from sero_mj.base import paths
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.robots.declared.surroundings import Object

HALF_PI = math.pi / 2
MODELS = paths.models_dir()


def torso(q):
    waist = chain(move(z=0.77), rot(2, q[0]), rot(1, q[1]))
    return chain(waist, move(z=0.30), rot(1, q[2]), move(z=0.34))


def head(q):
    camera = np.eye(4)
    camera[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]  # looks along x, sees y to its left
    return chain(move(z=0.065), rot(2, q[0]), rot(1, q[1]), move(0.13, 0, 0.105), camera)


def space_torso(q):
    return chain(move(z=0.85), rot(2, q[0]), move(z=0.46))


def wheel(q):
    return chain(move(z=0.10), rot(2, q[0]), rot(1, q[1]), rot(0, -HALF_PI))


def hit_finger(q):
    bent = chain(rot(1, -q[1]), move(0.055), rot(1, -q[2]), move(0.025), rot(1, -q[3]))
    return chain(rot(2, q[0]), bent, move(0.025), rot(0, HALF_PI))


def dlr_hand2_finger(q):
    bent = chain(rot(1, -q[1]), move(0.075), rot(1, -q[2]), move(0.04), rot(1, -math.pi / 9))
    return chain(rot(2, q[0]), bent, move(0.035), rot(0, HALF_PI))


def leg(q):
    hip = chain(rot(2, q[0]), rot(0, q[1]), rot(1, q[2]))
    shank = chain(move(z=-0.4), rot(1, q[3]), move(z=-0.4))
    return chain(hip, shank, rot(1, q[4]), rot(0, q[5]), move(0.1, 0, -0.07), rot(1, q[6]), FOOT)


FOOT = move(z=-0.02)
BY_HAND = {
    "justin_torso": torso,
    "justin_head": head,
    "space_justin_torso": space_torso,
    "justin_wheel": wheel,
    "hit_finger": hit_finger,
    "dlr_hand2_finger": dlr_hand2_finger,
    "biped_leg": leg,
}


def corners(world: World, data: mujoco.MjData) -> np.ndarray:
    """Returns all mesh vertices in the world, (k, 3), m."""
    model = world.model
    found = []
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH):
        mesh = model.geom_dataid[geom]
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        rotation = data.geom_xmat[geom].reshape(3, 3)
        found.append(model.mesh_vert[start : start + count] @ rotation.T + data.geom_xpos[geom])
    return np.concatenate(found)


def standing(*robots: SerialRobot, objects: tuple[Object, ...] = ()) -> np.ndarray:
    world = World(Scene(robots=list(robots), objects=list(objects), floor=False))
    return corners(world, world.make_data())


@pytest.mark.parametrize("name", BY_HAND)
def test_table_and_model_agree_with_named_joint_rotations(name):
    robot = SerialRobot.from_model(name)
    world = World(Scene(robots=[robot]))
    data = world.make_data()
    for q in np.random.default_rng(3).uniform(-1.2, 1.2, (25, robot.n)):
        world.set_input(data, f"{name}.joint_angles", q)
        mujoco.mj_kinematics(world.model, data)
        expected = BY_HAND[name](q)
        np.testing.assert_allclose(robot.fwd_kin_base_to_flange(q), expected, atol=2e-6)
        np.testing.assert_allclose(world.fwd_kin_base_to_flange(data, name), expected, atol=2e-6)


@pytest.mark.parametrize("name", BY_HAND)
def test_unpublished_data_is_marked_as_approximate(name):
    robot = SerialRobot.from_model(name)
    assert robot.note.endswith("approximate, not DLR data")
    text = (MODELS / name / "robot.toml").read_text()
    assert "approximate, not DLR data" in text and "Interactive Features" in text


@pytest.mark.parametrize("name", BY_HAND)
def test_links_have_mass_and_every_small_mesh_file_is_used(name):
    robot = SerialRobot.from_model(name)
    used = {mesh.file for link in robot.filenames for mesh in link}
    files = {path.name: path.stat().st_size for path in (MODELS / name / "meshes").glob("*.stl")}
    assert used == {file for file in files if not file.startswith("palm_")}
    assert sum(files.values()) < 750_000
    assert {mesh.color for link in robot.filenames for mesh in link} == set(robot.colors)
    masses = robot_dynamics(robot).masses
    assert (masses > 0).all()
    World(Scene(robots=[robot]), dynamic=True)


def test_all_robots_share_the_colors_of_the_lwr(lwr):
    shared = dict(lwr.colors)
    for name in BY_HAND:
        for colour, rgba in SerialRobot.from_model(name).colors.items():
            np.testing.assert_array_equal(shared.setdefault(colour, rgba), rgba)


def test_justin_has_the_published_height_and_stands_on_its_wheels():
    torso = SerialRobot.from_model("justin_torso")
    chest = torso.base_frame @ torso.fwd_kin_base_to_flange()
    np.testing.assert_allclose(chest, move(z=1.41), atol=1e-12)
    head = SerialRobot.from_model("justin_head", base_frame=chest @ move(-0.008, 0, 0.115))
    top = standing(torso, head)[:, 2].max()
    assert 1.70 < top <= 1.91
    wheel = standing(SerialRobot.from_model("justin_wheel"))
    assert abs(wheel[:, 2].min()) < 1e-6


def test_biped_stands_flat_on_the_floor_in_its_shipped_pose():
    leg = SerialRobot.from_model("biped_leg")
    hip = 0.09 + 0.8 * math.cos(0.35)
    standing_leg = leg.model_copy(update={"base_frame": move(z=hip)})
    sole = leg.dh.frames(leg.home)[6:8, :3, :3] @ [1, 0, 0]  # x of foot and toe is down
    np.testing.assert_allclose(sole, [[0, 0, -1]] * 2, atol=1e-12)
    points = standing(standing_leg)
    assert abs(points[:, 2].min()) < 1e-3
    # Foot and toe both touch: points on the floor are behind the ankle and in front of the toes.
    floor = points[points[:, 2] < 2e-3]
    assert floor[:, 0].min() < -0.05 and floor[:, 0].max() > 0.14


def test_last_joint_of_a_hit_finger_follows_the_previous_one():
    finger = SerialRobot.from_model("hit_finger", joint_angles=[0.1, 0.5, 0.4])
    assert finger.home.tolist() == [0.1, 0.5, 0.4, 0.4]


# Bases of the fingers of a right hand: eaa3/dlr_hit_hand_ii, or our own for the other hand.
HIT = {
    "thumb": ([0.062569, 0.044545, 0.080045], [0.41136, -1.08366, 0.225804]),
    "index": ([-0.002530, 0.036800, 0.108744], [3.05433, -HALF_PI, 0]),
    "middle": ([-0.003700, 0.010000, 0.119044], [math.pi, -HALF_PI, 0]),
    "ring": ([-0.002530, -0.016800, 0.114044], [-3.05433, -HALF_PI, 0]),
    "little": ([0.000972, -0.043396, 0.095044], [-2.96706, -HALF_PI, 0]),
}
DLR = {
    "thumb": ([0.068, 0.066, 0.108], np.deg2rad([25, -60, 15])),
    "index": ([-0.003, 0.045, 0.142], np.deg2rad([174, -90, 0])),
    "middle": ([-0.003, 0.000, 0.150], np.deg2rad([180, -90, 0])),
    "ring": ([-0.003, -0.045, 0.142], np.deg2rad([186, -90, 0])),
}


@pytest.mark.parametrize(("model", "bases"), [("hit_finger", HIT), ("dlr_hand2_finger", DLR)])
def test_fingers_are_attached_to_their_palm_and_close_inward(model, bases):
    inside = standing(objects=(palm_of(model, "palm.xml"),))
    for name, (xyz, rpy) in bases.items():
        T = chain(move(*xyz), rot(2, rpy[2]), rot(1, rpy[1]), rot(0, rpy[0]))
        gap = np.linalg.norm(inside - T[:3, 3], axis=1).min()
        assert gap < 0.025, f"{name} floats {gap:.3f} m from the palm"
        finger = SerialRobot.from_model(model)
        bent = T @ finger.fwd_kin_base_to_flange([0, *[1.0] * (finger.n - 1)])
        stretched = T @ finger.fwd_kin_base_to_flange(np.zeros(finger.n))
        if name == "thumb":  # the thumb opposes the other fingers
            assert bent[1, 3] < stretched[1, 3]
        else:
            assert bent[0, 3] > stretched[0, 3] + 0.02


def palm_of(model: str, file: str) -> Object:
    return Object(name="palm", directory=str(MODELS / model), mjcf=file)


@pytest.mark.parametrize("model", ["hit_finger", "dlr_hand2_finger"])
def test_left_palm_mirrors_the_right_one(model):
    right, left = (standing(objects=(palm_of(model, f),)) for f in ("palm.xml", "palm_left.xml"))
    right = right * (1, -1, 1)
    order = [np.lexsort(np.round(points, 6).T) for points in (right, left)]
    np.testing.assert_allclose(right[order[0]].max(axis=0), left[order[1]].max(axis=0), atol=1e-6)
    np.testing.assert_allclose(right.mean(axis=0), left.mean(axis=0), atol=1e-6)


SCRIPTED = sorted(path.parent.name for path in MODELS.glob("*/make_meshes.py"))


@pytest.mark.skipif(importlib.util.find_spec("trimesh") is None, reason="needs trimesh")
@pytest.mark.parametrize("name", sampled(SCRIPTED, 2))
def test_mesh_script_reproduces_the_committed_files(name, tmp_path):
    shutil.copytree(MODELS, tmp_path / "models", ignore=shutil.ignore_patterns("*.stl"))
    folder = tmp_path / "models" / name
    done = subprocess.run(
        [sys.executable, "make_meshes.py"], cwd=folder, capture_output=True, text=True, check=True
    )
    made = {path.name: path.read_bytes() for path in (folder / "meshes").iterdir()}
    committed = {path.name: path.read_bytes() for path in (MODELS / name / "meshes").iterdir()}
    assert made.keys() == committed.keys()
    different = [file for file in made if made[file] != committed[file]]
    assert different == []
    total = re.search(r"^total (\d+)$", done.stdout, re.MULTILINE)
    # A binary STL file is 84 bytes and 50 for each triangle.
    assert int(total[1]) == sum((len(file) - 84) // 50 for file in committed.values())
