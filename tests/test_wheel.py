"""The wheel carries models and scenes and works without the checkout."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from conftest import ROOT


@pytest.mark.slow
def test_the_wheel_works_from_another_directory(tmp_path: Path) -> None:
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
