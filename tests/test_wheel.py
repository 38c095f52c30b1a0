"""The wheel contains models and scenes and works without the checkout."""

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
from conftest import ROOT


@pytest.mark.slow
def test_wheel_works_from_another_directory(tmp_path: Path) -> None:
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation",
         "--disable-pip-version-check", "--wheel-dir", str(tmp_path), str(ROOT)],
        check=True,
    )  # fmt: skip
    (wheel,) = tmp_path.glob("*.whl")
    installed, elsewhere = tmp_path / "installed", tmp_path / "elsewhere"
    elsewhere.mkdir()
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        archive.extractall(installed)
    assert "sero_mj/models/lwr/robot.toml" in names
    assert "sero_mj/scenes/lwr_udp.toml" in names
    assert {f"sero_mj/scenes/lwr_shm{end}" for end in (".toml", "_writer.c", "_writer.py")} <= {
        *names
    }
    assert {"sero_mj/py.typed", "sero_mj/viewer/fonts/Inter-Medium.ttf"} <= {*names}
    assert "sero_mj/viewer/fonts/OFL.txt" in names
    (metadata,) = (name for name in names if name.endswith(".dist-info/METADATA"))
    with zipfile.ZipFile(wheel) as archive:
        about = archive.read(metadata).decode()
    assert "License-Expression: Apache-2.0" in about and "License-File: LICENSE" in about
    assert "![" not in about  # package indexes do not have the images
    assert not any(name.startswith(("tests/", "benchmarks/", "models/")) for name in names)

    code = "import sero_mj; print(sero_mj.__file__); from sero_mj.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "check", "lwr_udp"],
        cwd=elsewhere,
        env={**os.environ, "PYTHONPATH": str(installed)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert str(installed) in done.stdout.splitlines()[0]
    assert "robot   lwr: 7 joints, craig DH, meshes" in done.stdout


@pytest.mark.thorough
@pytest.mark.slow
def test_source_distribution_has_everything_for_the_readme_commands(tmp_path: Path) -> None:
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", str(tmp_path)],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    (archive,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(archive) as tar:
        names = {name.partition("/")[2] for name in tar.getnames()}
    assert {
        "Makefile", ".ci/setup", ".ci/run", "LICENSE", "CITATION.cff", "CONTRIBUTING.md",
        "models/lwr/robot.toml", "scenes/lwr_udp.toml", "tests/conftest.py",
        "benchmarks/run.py", "sero_mj/py.typed",
    } <= names  # fmt: skip


_DOWNSTREAM = """\
from sero_mj import Object, Scene, SerialRobot, UdpReceiver

robot = SerialRobot(dh_convention="craig", dh_params=[[0, 0, 0, 0.3]], show_arrows=True)
source = UdpReceiver(structure="7F7F", udpport=32000)
scene = Scene(robots=[robot], sources={"udp": source})
box = Object(name="box", shape="box", size=[1, 2, 3], frame={"xyz": [0, 0, 1]})
print(robot.names + 1)
"""


@pytest.mark.thorough
@pytest.mark.slow
def test_type_checker_of_a_downstream_project_sees_our_types(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(_DOWNSTREAM)
    cache = ROOT / ".mypy_cache" / "downstream"  # of NumPy and others, which take 5 s
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", f"--cache-dir={cache}", "mine.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    errors = [line for line in done.stdout.splitlines() if "error:" in line]
    assert len(errors) == 1 and errors[0].startswith("mine.py:7: error:"), done.stdout
    assert "list[str]" in done.stdout
