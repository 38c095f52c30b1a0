"""The peer comparison: all packages read the same robot, and the page names faster ones."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest
from conftest import ROOT, import_script

from sero_mj.load import load_scene
from sero_mj.robots.assemble.forward_kinematics import ForwardKinematics
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene

BENCHMARKS = ROOT / "benchmarks"


@pytest.fixture
def peers(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(BENCHMARKS)
    monkeypatch.syspath_prepend(BENCHMARKS / "peers")
    return import_script(BENCHMARKS / "peers.py")


def test_urdf_equals_the_robot_in_poses_masses_and_meshes(tmp_path: Path) -> None:
    write_urdf = import_script(BENCHMARKS / "peers" / "urdf_of.py").write_urdf
    robot = SerialRobot.from_model("lwr")
    world = World(Scene(robots=[robot]))
    path = tmp_path / "robot.urdf"
    write_urdf(world.model, world.robots["lwr"].flange_body, path)
    (read,) = load_scene(path).robots.values()
    poses = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 7))
    flange = robot.base_frame @ ForwardKinematics(robot)(poses)
    np.testing.assert_allclose(ForwardKinematics(read)(poses), flange, atol=1e-12)
    alone = mujoco.MjModel.from_xml_path(str(path))
    assert alone.body_mass.sum() == pytest.approx(world.model.body_mass.sum(), rel=1e-12)
    assert alone.nmesh == len([*(tmp_path / "robot").glob("*.stl")]) > 0


def test_faster_peer_is_named_with_the_reason(peers: ModuleType) -> None:
    rows = {
        "ours": peers.Row("sero-mj", [2e-6, 2e-6, 9e-6]),
        "with_pinocchio": peers.Row("Pinocchio", [1e-6, 1e-6, 1e-6]),
        "with_roboticstoolbox": peers.Row("roboticstoolbox", problem="no wheel"),
        "bare_mujoco": peers.Row("MuJoCo alone", [3e-6]),
    }
    text = peers.table_of("fk_one", rows)
    assert "| sero-mj | 2 us | 1 |" in text
    assert "| Pinocchio | 1 us | 0.5 |" in text
    assert "| MuJoCo alone | 3 us | 1.5 |" in text
    assert "| roboticstoolbox | not measured: no wheel | |" in text
    assert text.count("is faster: ") == 1
    assert f"Pinocchio is faster: {peers.WORKS['fk_one'].why['with_pinocchio']}." in text


def test_higher_rate_is_faster(peers: ModuleType) -> None:
    rows = {
        "recvmmsg loop in C, alone": peers.Row("recvmmsg loop in C, alone", [2.5e-6]),
        "UdpReceiver, none lost": peers.Row("UdpReceiver, none lost", [5e-6]),
    }
    text = peers.table_of("packets", rows)
    assert "| recvmmsg loop in C, alone | 400,000/s | 2 |" in text
    assert "| UdpReceiver, none lost | 200,000/s | 1 |" in text
    assert "recvmmsg loop in C, alone is faster: it only counts packets" in text


def test_every_peer_has_its_script_and_we_do_every_task(peers: ModuleType) -> None:
    for name in peers.PEERS:
        assert (BENCHMARKS / "peers" / f"{name}.py").is_file()
    for key, work in peers.WORKS.items():
        assert work.peers[0] == "ours"
        for name in work.peers:
            assert f'"{key}": ' in (BENCHMARKS / "peers" / f"{name}.py").read_text(), (key, name)
