"""A recording alone shows its scene on any machine."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from sero_mj import UdpReceiver, World, load_scene
from sero_mj.base import paths
from sero_mj.base.errors import SeroError
from sero_mj.cli import main
from sero_mj.cli.opening import view_of_file
from sero_mj.data.drive.record_sources import record_sources
from sero_mj.data.record import scene_files
from sero_mj.data.record.recording import Recording
from sero_mj.data.record.recording_writer import RecordingWriter
from sero_mj.data.record.scene_files import write_scene
from sero_mj.robots.declared.scene import Scene

_SCENE = """
[robots.arm]
model = "MODEL"

[sources.udp]
kind = "udp"
port = 0
structure = "7F"

[routes]
"arm.joint_angles" = "udp.values0"
"""


def recorded(folder: Path, model: str, *, copies: bool = True) -> Path:
    """Writes a recording without packets of a scene with its own robot, beside the scene."""
    if copies:
        shutil.copytree(paths.models_dir() / "lwr", folder / model)
    file = folder / "cell.toml"
    file.write_text(_SCENE.replace("MODEL", model))
    scene = load_scene(file)
    source = UdpReceiver(structure="7F", udpport=0)
    path = folder / "run.mcap"
    with source, record_sources({"udp": source}, path, scene=scene):
        pass
    return path


@pytest.mark.parametrize("model", ["arm", "robots/big/arm"])
def test_recording_is_shown_without_its_original_files(
    model: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
    path = recorded(here, model)
    before = World(load_scene(here / "cell.toml")).model
    alone = Path(shutil.copy(path, there))
    shutil.rmtree(here)
    found = load_scene(view_of_file(alone, None).scene)
    assert isinstance(found, Scene) and paths.is_temporary(str(found.file))
    after = World(found).model
    assert after.nmeshvert == before.nmeshvert > 1000
    assert np.array_equal(after.mesh_vert, before.mesh_vert)


def test_meshes_too_large_for_a_recording_are_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(scene_files, "_MAX_MESH_BYTES", 1000)
    monkeypatch.setenv("HOME", str(tmp_path))
    (here := tmp_path / "here").mkdir()
    path = recorded(here, "arm")
    (record,) = [each for each in caplog.records if "meshes of" in each.getMessage()]
    assert "maximum: 0 MB" in record.getMessage() and "cell.toml" in record.getMessage()
    with Recording(path) as recording:
        assert sorted(recording.attachments) == ["arm/robot.toml", "here/cell.toml"]


def test_scene_that_cannot_be_shown_alone_reports_the_missing_option(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    path = tmp_path / "run.mcap"
    with RecordingWriter(path, about={"scene": "cell"}) as writer:
        writer.attach("w/cell.toml", "application/toml", _SCENE.replace("MODEL", "gone").encode())
    with pytest.raises(SeroError) as error:
        view_of_file(path, None)
    assert "gone" in str(error.value) and "--replay run.mcap" in str(error.value)
    assert "/sero-mj-" not in str(error.value)


def test_shipped_robot_is_loaded_from_the_installation(tmp_path: Path) -> None:
    (folder := tmp_path / "here").mkdir()
    path = Path(shutil.move(recorded(folder, "lwr", copies=False), tmp_path))
    with Recording(path) as recording:
        assert "lwr/robot.toml" in recording.attachments  # without its meshes
    shutil.rmtree(folder)
    found = load_scene(view_of_file(path, None).scene)
    assert World(found).model.nmeshvert > 1000


def test_recording_is_shown_by_its_name_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, picture = recorded(tmp_path, "arm"), tmp_path / "picture.png"
    for command in (["render", "-o", str(picture)], ["export", "-o", str(tmp_path / "a.html")]):
        with pytest.raises(SystemExit) as end:
            main([*command, str(path), "--replay", str(path)])
        assert end.value.code == 2
        assert capsys.readouterr().err == f"sero-mj: --replay: {path} is already a recording\n"
    shutil.rmtree(tmp_path / "arm")
    (tmp_path / "cell.toml").unlink()
    with pytest.raises(SystemExit) as end:
        main(["render", str(path), "-o", str(picture), "--quality", "draft", "--wait", "0"])
    assert end.value.code == 0 and picture.stat().st_size > 1000


def test_recording_writes_nothing_outside_its_folder(tmp_path: Path) -> None:
    path, folder = tmp_path / "evil.mcap", tmp_path / "a" / "b"
    with RecordingWriter(path, about={"scene": "cell"}) as writer:
        for name in ("w/cell.toml", "files/../../bad", "files//bad", "../../bad", "files/good"):
            writer.attach(name, "text/plain", b"x")
    folder.mkdir(parents=True)
    with Recording(path) as recording:
        assert write_scene(recording, "cell", folder) == folder / "cell.toml"
        assert write_scene(recording, "other", folder) is None
    written = sorted(each.name for each in tmp_path.rglob("*") if each.is_file())
    assert written == ["cell.toml", "evil.mcap", "good"]
