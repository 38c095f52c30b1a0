"""Robots by external names: descriptions in a cache, a checkout of models, ROS packages."""

from __future__ import annotations

import contextlib
import os
import pty
import subprocess
import sys
import termios
from collections.abc import Mapping
from pathlib import Path

import pytest
from commands import UNSET, run_command
from conftest import raises_with

from sero_mj import load_scene
from sero_mj.base import paths
from sero_mj.base.errors import UnknownName, UsageError
from sero_mj.robots.importers.robot_places import RobotDescriptions

ARM = """<mujoco model="arm"><worldbody><body name="a"><geom size=".1"/>
<body name="b" pos="0 0 .3"><joint name="turn" axis="0 0 1"/><geom size=".1"/></body></body>
</worldbody></mujoco>"""
URDF = """<robot name="{name}"><link name="base"/><link name="arm"/>
<joint name="{joint}" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="10" velocity="1"/></joint></robot>"""


@pytest.fixture
def menagerie(tmp_path: Path) -> Path:
    for folder in ("universal_robots_ur16e", "universal_robots_ur20", "kuka_iiwa_14", "franka_fr3"):
        (tmp_path / "checkout" / folder).mkdir(parents=True)
        (tmp_path / "checkout" / folder / f"{folder.rpartition('_')[2]}.xml").write_text(ARM)
        scene = f'<mujoco><include file="{folder.rpartition("_")[2]}.xml"/></mujoco>'
        (tmp_path / "checkout" / folder / "scene.xml").write_text(scene)
    (tmp_path / "checkout" / "assets").mkdir()
    return tmp_path / "checkout"


@pytest.mark.parametrize(
    ("name", "folder"),
    [
        ("universal_robots_ur16e", "universal_robots_ur16e"),
        ("ur16e", "universal_robots_ur16e"),
        ("UR20", "universal_robots_ur20"),
        ("lbr_iiwa14_r820", "kuka_iiwa_14"),
        ("iiwa", "kuka_iiwa_14"),
        ("franka_research_3", "franka_fr3"),
    ],
)
def test_menagerie_model_is_found_by_name(
    menagerie: Path, monkeypatch: pytest.MonkeyPatch, name: str, folder: str
) -> None:
    monkeypatch.setenv("MENAGERIE_PATH", str(menagerie))
    assert paths.find_model(name) == menagerie / folder / "scene.xml"
    scene = load_scene(name)
    assert [robot.names for robot in scene.robots.values()] == [["turn"]]
    assert scene.name == folder


def test_clone_in_the_working_directory_is_found(
    menagerie: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("MENAGERIE_PATH", raising=False)
    menagerie.rename(menagerie.with_name("mujoco_menagerie"))
    monkeypatch.chdir(menagerie.parent)
    assert paths.find_model("franka_fr3").parent.name == "franka_fr3"
    Path("scene.toml").write_text(
        '[robots.left]\nmodel = "franka_fr3"\n[robots.right]\nmodel = "ur16e"\n'
    )
    assert list(load_scene("scene.toml").robots) == ["left", "right"]
    with raises_with(UnknownName, hint="; did you mean 'universal_robots_ur16e'?"):
        paths.find_model("universal_robot_ur16e")


def test_file_in_a_ros_package_is_a_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "arm_description" / "urdf").mkdir(parents=True)
    (tmp_path / "arm_description" / "urdf" / "arm.urdf").write_text(
        URDF.format(name="arm", joint="turn")
    )
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    robot = load_scene("package://arm_description/urdf/arm.urdf").robots["arm"]
    assert robot.names == ["turn"]
    with pytest.raises(UsageError) as error:
        load_scene("package://arm_description/urdf/arm2.urdf")
    assert str(error.value).startswith("package://arm_description/urdf/arm2.urdf: no such file")


def cached(cache: Path, repository: str, files: Mapping[str, str]) -> dict[str, str]:
    """Returns the environment to use a repository in the cache of `robot_descriptions`."""
    work = cache / "work"
    for name, text in files.items():
        (work / name).parent.mkdir(parents=True, exist_ok=True)
        (work / name).write_text(text)
    who = ["-c", "user.name=a", "-c", "user.email=a@b"]
    for words in (["init", "-q"], ["add", "."], [*who, "commit", "-qm", "all"]):
        subprocess.run(["git", *words], cwd=work, check=True)
    asked = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=work, check=True, capture_output=True, text=True
    )
    commit = asked.stdout.strip()
    (cache / f"{repository}-{commit}").mkdir()
    work.rename(cache / f"{repository}-{commit}" / repository)
    known = {key: value for key, value in os.environ.items() if key not in UNSET}
    return {**known, "ROBOT_DESCRIPTIONS_CACHE": str(cache), "ROBOT_DESCRIPTION_COMMIT": commit}


def test_cached_description_needs_no_network(tmp_path: Path) -> None:
    urdf = URDF.format(name="panda", joint="panda_joint1")
    files = {"robots/panda_description/urdf/panda.urdf": urdf}
    environment = cached(tmp_path / "cache", "example-robot-data", files)
    status, output = run_command(["check", "panda_description"], tmp_path, environment)
    assert status == 0, output
    assert "panda: no errors" in output and "moved by joint panda_joint1;" in output
    (tmp_path / "scene.toml").write_text('[robots.one]\nmodel = "panda_description"\n')
    status, output = run_command(["check", "scene.toml"], tmp_path, environment)
    assert status == 0 and "robot   one: 1 joints" in output


def test_xacro_description_has_its_arguments(tmp_path: Path) -> None:
    top = (
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="$(arg name)">'
        '<xacro:arg name="ur_type" default="ur3"/><xacro:arg name="name" default="none"/>'
        '<xacro:include filename="$(find ur_description)/urdf/inc/$(arg ur_type).xacro"/></robot>'
    )
    part = URDF.format(name="part", joint="shoulder_pan_joint")
    files = {
        "package.xml": "<package><name>ur_description</name></package>",
        "urdf/ur.urdf.xacro": top,
        "urdf/inc/ur5e.xacro": part,
    }
    environment = cached(tmp_path / "cache", "ur_description", files)
    status, output = run_command(["check", "ur5e_description"], tmp_path, environment)
    assert status == 0, output
    assert (
        "ur5e_description: no errors" in output and "moved by joint shoulder_pan_joint;" in output
    )


def test_failed_downloads_are_reported(tmp_path: Path) -> None:
    environment = cached(tmp_path / "cache", "example-robot-data", {"README": "empty"})
    (folder,) = (tmp_path / "cache").iterdir()
    other = "0" * 40
    folder.rename(folder.with_name(f"example-robot-data-{other}"))
    environment["ROBOT_DESCRIPTION_COMMIT"] = other  # which would require a download
    status, output = run_command(["check", "panda_description"], tmp_path, environment)
    assert status == 2
    (line,) = [each for each in output.splitlines() if each.startswith("sero-mj: ")]
    assert line.startswith("sero-mj: robot_descriptions cannot fetch panda_description: ")
    assert "Traceback" not in output


def test_file_with_the_name_of_a_description_downloads_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = tmp_path / "panda_description.urdf"
    file.write_text(URDF.format(name="panda_description", joint="joint1"))
    monkeypatch.setitem(sys.modules, "robot_descriptions.panda_description", None)  # no import
    scene = load_scene(str(file))
    assert scene.argument == str(file)


def test_known_names_are_listed_and_suggested(tmp_path: Path) -> None:
    environment = {key: value for key, value in os.environ.items() if key not in UNSET}
    status, output = run_command(["list", "--known"], tmp_path, environment)
    assert status == 0 and "MuJoCo Menagerie: no clone" in output
    lines = output.splitlines()
    assert "  ur5e_description" in lines  # one per line if the output is not a terminal
    names = lines[lines.index("robot_descriptions") + 1 :]
    assert len(names) > 100 and names == sorted(names)
    for name in ("talos_descriptio", "talos", "Talos"):
        with raises_with(UnknownName, hint="; did you mean 'talos_description'?"):
            load_scene(name)


def test_names_are_in_columns_that_fit_the_terminal(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, (40, 100))
    command = [sys.executable, "-m", "sero_mj", "list", "--known"]
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=theirs, cwd=tmp_path
    ) as process:
        os.close(theirs)
        said = b""
        with contextlib.suppress(OSError):  # at the end of the stream
            while more := os.read(ours, 65536):
                said += more
    os.close(ours)
    lines = said.decode().splitlines()
    assert process.returncode == 0
    assert 60 < max(map(len, lines)) <= 100
    first, second = lines[lines.index("robot_descriptions") + 1 :][:2]
    assert first.split()[0] < second.split()[0] < first.split()[1]


@pytest.mark.parametrize(
    ("name", "shipped"),
    [("franka_fr3", "fr3"), ("UR5e", "ur5e"), ("lbr_iiwa14_r820", "iiwa14"), ("LWR", "lwr")],
)
def test_manufacturer_spellings_find_shipped_robots(name: str, shipped: str) -> None:
    assert paths.find_model(name) == paths.models_dir() / shipped / "robot.toml"


def test_missing_package_has_no_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "robot_descriptions", None)
    assert RobotDescriptions().names() == [] and RobotDescriptions().find("ur5e") is None
