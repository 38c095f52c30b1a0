"""Rollin' Justin, SpaceJustin and telepresence: group models, packets, motion, and a push."""

from __future__ import annotations

import itertools
import socket
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from conftest import import_script, raises_with
from poses import chain, move, rot

from sero_mj import Mirror, Scenario, Scene, Simulation, World, load_scene
from sero_mj.base.paths import models_dir, scenes_dir
from sero_mj.data.send.motion import CommonMotion
from sero_mj.data.send.play import MotionPackets
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.viewer.decor.joint_titles import titles
from sero_mj.viewer.decor.toggles import Toggles

S = np.diag([1.0, -1.0, 1.0, 1.0])
Array = np.ndarray[Any, np.dtype[np.float64]]
JUSTIN = ["torso", "head", "left_arm", "right_arm"]
JUSTIN += [f"{s}_hand_{n}" for s in ("left", "right") for n in ("thumb", "index", "middle", "ring")]
JUSTIN += [f"{n}_wheel" for n in ("front_left", "front_right", "rear_left", "rear_right")]


@cache
def toml(model: str, file: str) -> dict[str, Any]:
    return tomllib.loads((models_dir() / model / file).read_text("utf-8"))


def frame(table: dict[str, Any]) -> Array:
    """Returns a frame as in files, composed of rotations."""
    roll, pitch, yaw = (
        np.deg2rad(table["rpy_deg"]) if "rpy_deg" in table else table.get("rpy", [0] * 3)
    )
    return chain(move(*table.get("xyz", [0] * 3)), rot(2, yaw), rot(1, pitch), rot(0, roll))


def rows(model: str) -> Array:
    table = toml(model, "robot.toml")
    if "dh_params" in table:
        return np.array(table["dh_params"], float)
    return np.array(table["dh_params_deg"], float) * [np.pi / 180, 1, np.pi / 180, 1]


def links(model: str, q: Array) -> list[Array]:
    """Returns frames of base, links and flange of a model in its base, from its table alone."""
    found = [np.eye(4)]
    for (alpha, a, theta, d), angle in zip(rows(model), q, strict=True):
        found.append(chain(found[-1], rot(0, alpha), move(a), rot(2, theta + angle), move(z=d)))
    flange = toml(model, "robot.toml").get("flange_frame", {})
    return [*found, found[-1] @ frame(flange)]


def members(model: str) -> dict[str, dict[str, Any]]:
    """Returns the robots of a group model and of its groups, as in its files."""
    own = toml(model, "group.toml")
    found = {name: {**table, "outer": None} for name, table in own["robots"].items()}
    for group, table in own.get("groups", {}).items():
        for name, inner in toml(table["model"], "group.toml")["robots"].items():
            found[f"{group}_{name}"] = {**inner, "outer": table}
    return found


def all_links(model: str, q: dict[str, Array]) -> dict[str, list[Array]]:
    """Returns frames of all links in the world; each left link mirrors the right one."""
    found: dict[str, list[Array]] = {}
    for name, table in members(model).items():
        outer = table["outer"] or {}
        mirrored = table.get("mirrored", False) or outer.get("mirrored", False)
        own = frame(table.get("base_frame", {}))
        base = frame(outer.get("base_frame", {})) @ (S @ own @ S if outer.get("mirrored") else own)
        mount = outer.get("mount", table.get("mount"))
        if mount is not None:
            below, _, label = mount.partition("/")
            base = found[below][{"base": 0, "flange": -1}[label]] @ base
        chained = links(table["model"], q[name])
        found[name] = [base @ (S @ T @ S if mirrored else T) for T in chained]
    return found


def pose(scene: Scene, seed: int) -> dict[str, Array]:
    random = np.random.default_rng(seed)
    return {
        name.removeprefix(f"{scene.name}_"): robot.coupled.positions(
            random.uniform(-0.6, 0.6, robot.coupled.k)
        )
        for name, robot in scene.robots.items()
    }


@pytest.mark.parametrize("model", ["justin", "space_justin", "dlr_hand2", "hit_hand2"])
def test_frames_are_products_of_the_tables_in_the_files(model: str) -> None:
    scene = load_scene(models_dir() / model / "group.toml")
    world = World(scene)
    data = world.make_data()
    for seed in range(3):
        q = pose(scene, seed)
        for name, angles in q.items():
            world.set_input(data, f"{model}_{name}.joint_angles", angles)
        mujoco.mj_kinematics(world.model, data)
        for name, expected in all_links(model, q).items():
            flange = world.frame(data, f"{model}_{name}/flange")
            np.testing.assert_allclose(flange, expected[-1], atol=2e-6)


@pytest.mark.parametrize("model", ["dlr_hand2", "hit_hand2"])
def test_fingers_of_a_hand_alone_do_not_touch_its_palm(model: str) -> None:
    world = World(load_scene(model), dynamic=True)
    data = world.make_data()
    before = data.qpos.copy()
    for _ in range(20):
        mujoco.mj_step(world.model, data)
        assert data.ncon == 0
    assert np.abs(data.qpos - before).max() < 0.01
    # Links farther out do: a link three joints away is not adjacent.
    robots = [part for part in world.robots.values() if part.robot.mount is None]
    near, far = (world.model.body(f"{robots[1].robot.name}/link{i}").id for i in (2, 3))
    excluded = {(int(s) >> 16, int(s) & 0xFFFF) for s in world.model.exclude_signature}
    base = int(robots[0].bodies[0])
    assert {(base, near), (near, base)} & excluded and not {(base, far), (far, base)} & excluded


def test_joint_counts_equal_the_published_ones() -> None:
    counts = {
        model: np.sum([(r.n, r.coupled.k) for r in load_scene(model).robots.values()], axis=0)
        for model in ("justin", "space_justin", "dlr_hand2", "hit_hand2")
    }
    found = {model: count.tolist() for model, count in counts.items()}
    assert found == {
        "justin": [51, 51], "space_justin": [57, 47], "dlr_hand2": [12, 12], "hit_hand2": [20, 15],
    }  # fmt: skip


def test_mass_and_gravity_torques_equal_those_of_the_links() -> None:
    scene = load_scene(models_dir() / "justin" / "group.toml")
    world = World(Scene(robots=[*scene.robots.values()], floor=False), dynamic=True)
    data = world.make_data()
    palms = {
        name.partition("/")[0]: world.model.body(name)
        for name in (world.model.body(i).name for i in range(world.model.nbody))
        if name.endswith("/on_base")
    }
    assert [*palms] == ["justin_left_hand_thumb", "justin_right_hand_thumb"]
    parts = {name: robot_dynamics(robot) for name, robot in scene.robots.items()}
    # The platform is fixed in the world, so its mass does not matter.
    total = sum(part.masses.sum() for part in parts.values()) - parts["justin_torso"].masses[0]
    total += sum(palm.mass[0] for palm in palms.values())
    moving = world.model.body_mass.sum() - world.model.body("justin_torso/").mass[0]
    assert moving == pytest.approx(total, rel=1e-9)

    def potential(q: dict[str, Array]) -> float:
        energy = 0.0
        for name, frames in all_links("justin", q).items():
            part = parts[f"justin_{name}"]
            # Centers are in frames that are mirrored, as those of the masses are.
            for T, mass, centre in zip(frames[:-1], part.masses, part.centers, strict=True):
                energy += mass * 9.81 * (T @ [*centre, 1])[2]
            if f"justin_{name}" in palms:
                palm = palms[f"justin_{name}"]
                energy += palm.mass[0] * 9.81 * (frames[0] @ [*palm.ipos, 1])[2]
        return energy

    q = pose(scene, 5)
    for name, angles in q.items():
        data.qpos[world.robots[f"justin_{name}"].qpos] = angles
    mujoco.mj_forward(world.model, data)
    for name in ("torso", "left_arm", "right_arm", "left_hand_thumb"):
        bias = data.qfrc_bias[world.robots[f"justin_{name}"].dofs]
        for joint in range(len(q[name])):
            ends = []
            for step in (1e-5, -1e-5):
                moved = {**q, name: q[name] + step * (np.arange(len(q[name])) == joint)}
                ends.append(potential(moved))
            assert bias[joint] == pytest.approx((ends[0] - ends[1]) / 2e-5, abs=2e-4)


@pytest.mark.thorough
def test_one_packet_contains_all_angles_torques_and_the_platform_pose() -> None:
    scene = load_scene("justin")
    scene.sources["udp"]["port"] = 0
    layout = MotionPackets(scene).structure
    assert layout.size == 8 * (51 + 51 + 16)
    angles, torques = np.arange(51) / 100, np.arange(51) / 10
    base = chain(move(1.0, 2.0, 0.0), rot(2, 0.7))
    packet = layout.encode({"values0": angles, "values1": torques, "matrices0": base[None]})
    with Mirror(scene) as mirror, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(packet, ("127.0.0.1", mirror.sources["udp"].port))
        assert mirror.wait(5.0) == []
        mirror.advance()
        world, data = mirror.world, mirror.data
        assert [name.removeprefix("justin_") for name in scene.members("justin") or []] == JUSTIN
        got = [data.qpos[world.robots[f"justin_{name}"].qpos] for name in JUSTIN]
        np.testing.assert_allclose(np.concatenate(got), angles)
        felt = [data.userdata[world.slots[f"justin_{name}.torques"]] for name in JUSTIN]
        np.testing.assert_allclose(np.concatenate(felt), torques)
        np.testing.assert_allclose(world.frame(data, "justin_torso/base"), base, atol=1e-9)
        wheel = world.frame(data, "justin_rear_left_wheel/base")
        at = chain(base, move(-0.36, 0.31), rot(2, np.deg2rad(139.3)))
        np.testing.assert_allclose(wheel, at, atol=1e-9)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["justin", "space_justin"])
def test_no_links_collide_during_a_minute_of_motion(name: str) -> None:
    scene = load_scene(name)
    robots = [*scene.robots.values()]
    world = World(Scene(robots=robots, floor=False), dynamic=True)
    data, motion = world.make_data(), CommonMotion(robots, 1.0)
    moved = np.zeros(0)
    for t in np.arange(0.0, 60.0, 0.2):
        for robot in robots:
            data.qpos[world.robots[robot.name].qpos] = motion.of(robot.name, float(t), 0.0)[0]
        mujoco.mj_kinematics(world.model, data)
        mujoco.mj_comPos(world.model, data)
        mujoco.mj_collision(world.model, data)
        assert (data.contact.dist[: data.ncon] >= 0).all(), t
        moved = np.maximum(moved, abs(data.qpos)) if len(moved) else abs(data.qpos)
    arm = next(robot.name for robot in robots if robot.name.endswith("left_arm") or robot.n == 7)
    swings = [np.ptp([motion.of(arm, t, 0.0)[0] for t in np.arange(0, 9, 0.3)], axis=0)]
    assert np.max(swings) > 0.2  # and yet it moves


def test_wheels_roll_with_the_platform_without_slip() -> None:
    sender = import_script(scenes_dir() / "justin_sender.py")
    scene = load_scene("justin")
    world = World(scene)
    data = world.make_data()
    wheels = [name for name in scene.robots if name.endswith("_wheel")]
    way = sender.Platform(scene.robots)
    dt, travelled = 1e-3, 0.0
    before: dict[str, Array] = {}
    for k in range(3000, 4000):
        base, angles = way.go(k * dt, dt)
        world.set_input(data, "justin_torso.base_frame", base)
        for name, pair in zip(wheels, angles, strict=True):
            world.set_input(data, f"{name}.joint_angles", pair)
        mujoco.mj_kinematics(world.model, data)
        for name in wheels:
            T = world.frame(data, f"{name}/link2")
            if name in before and k > 3001:
                at = np.array([*T[:2, 3], 0.0, 1.0])  # of the tire's lowest point
                slip = (at - before[name] @ np.linalg.solve(T, at))[:3] / dt
                speed = np.linalg.norm(T[:2, 3] - before[name][:2, 3]) / dt
                # Steering rotates the tire about its contact point, which is not slip.
                assert np.linalg.norm(slip) < 0.02 * speed + 1e-3
                travelled += speed * dt
            before[name] = T
    assert travelled > 0.3


@pytest.mark.thorough
def test_pushed_arm_has_wide_arrows_and_the_others_thin_ones() -> None:
    simulation = Simulation(read_scenario("justin_push"))
    for _ in simulation.run():
        pass
    assert {
        outcome.name: outcome.text for outcome in simulation.outcomes() if not outcome.holds
    } == {}
    last = simulation.log
    share = {}
    for name, robot in simulation.scenario.scene.robots.items():
        torques = last.of(name, "torques")[1900:2900]
        assert robot.torque_limits is not None
        share[name] = np.max(abs(torques.mean(axis=0)) / robot.torque_limits)
    pushed = share.pop("justin_left_arm")
    assert pushed > 2 * max(share.values())


def test_group_controller_applies_to_robots_without_their_own() -> None:
    scene = load_scene("justin")
    tables = {
        "justin": {"kind": "joint_impedance", "stiffness": 500},
        "justin_left_hand": {"kind": "joint_impedance", "stiffness": 4},
        "justin_head": {"kind": "gravity_compensation"},
    }
    scenario = Scenario(scene, controllers=tables)
    found = {name: getattr(c, "stiffness", None) for name, c in scenario.controllers.items()}
    assert set(found) == set(scene.robots)
    assert found["justin_head"] is None
    assert found["justin_left_hand_ring"] == [4]
    assert found["justin_right_hand_ring"] == [500]
    with raises_with(key="controllers.justinn", reason="no robot", found="justinn", near="justin"):
        Scenario(scene, controllers={"justinn": {"kind": "gravity_compensation"}})


def test_group_name_shared_by_all_is_omitted_on_billboards() -> None:
    owners = ["justin_head", "justin_left_arm", "justin_right_arm"]
    found = titles([["tilt"], ["A1"], ["A1"]], owners, [True] * 3)
    assert found == ["head tilt", "left_arm A1", "right_arm A1"]
    other = titles([["tilt"], ["A1"]], ["justin_head", "just_an_arm"], [True] * 2)
    assert other == ["justin_head tilt", "just_an_arm A1"]


def test_only_visible_axes_show_their_names() -> None:
    world = World(load_scene("space_justin"))
    data = world.make_data()
    shown = Toggles(world).shown(data).frame_names
    names = {world.frames.names[i].partition("_justin_")[2] for i in shown.nonzero()[0]}
    arms = [f"left_arm/{label}" for label in ("shoulder", "wrist")]
    assert names == {"torso/body", *arms, *(name.replace("left", "right") for name in arms)}


@pytest.mark.thorough
def test_haptic_device_moves_the_arms_of_space_justin() -> None:
    scene = load_scene("telepresence")
    scene.sources["udp"]["port"] = 0
    layout = MotionPackets(scene).structure
    homes = [scene.robots[name].home for name in ("left", "right")]
    step = np.linspace(-0.1, 0.1, 14)
    values = {"values0": np.concatenate(homes) + step, "values1": np.ones(14)}
    values |= {"values2": np.full(33, 0.1), "values3": np.arange(47.0)}
    with Mirror(scene) as mirror, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(layout.encode(values), ("127.0.0.1", mirror.sources["udp"].port))
        assert mirror.wait(5.0) == []
        mirror.advance()
        world, data = mirror.world, mirror.data
        for name, share in (("left", step[:7]), ("right", step[7:])):
            part = world.robots[f"slave_{name}_arm"]
            np.testing.assert_allclose(
                data.qpos[part.qpos] - part.robot.home, 0.3 * share, atol=1e-4
            )
            thumb = data.qpos[world.robots[f"slave_{name}_hand_thumb"].qpos]
            np.testing.assert_allclose(thumb, 0.1)
        felt = data.userdata[world.slots["slave_right_hand_little.torques"]]
        np.testing.assert_array_equal(felt, [44.0, 45.0, 46.0, np.nan])


@pytest.mark.thorough
def test_packets_of_the_sender_are_played() -> None:
    sender = import_script(scenes_dir() / "justin_sender.py")
    scene = load_scene("justin")
    layout = MotionPackets(scene, amplitude=0.0).structure
    packets = [layout.decode(p) for p in itertools.islice(sender.packets(scene), 20)]
    at = np.array([packet["matrices0"][0][:2, 3] for packet in packets])
    assert (np.diff(at[:, 0]) > 0).all()
    drive = np.array([packet["values0"][44::2] for packet in packets])
    assert (np.diff(np.linalg.norm(drive, axis=1)) > 0).all()
    assert Path(sender.__file__).parent == scenes_dir()
