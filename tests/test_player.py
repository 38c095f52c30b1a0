"""What a player is given of a run: frames, lengths, marks, files; without a browser."""

from __future__ import annotations

import base64
import json
import os
import re
import subprocess
import zlib
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from commands import run_command as run_in_folder
from conftest import ROOT
from runs import simulated

from sero_mj.base.errors import RenderError, UsageError
from sero_mj.load import load_scene
from sero_mj.study import run_report
from sero_mj.study.run_report import marks_of
from sero_mj.viewer.decor.geom_buffer import Kind
from sero_mj.viewer.player.capture import capture
from sero_mj.viewer.player.encode import encode
from sero_mj.viewer.player.page import write_page


def run_command(*arguments: str, folder: Path) -> tuple[int, str]:
    return run_in_folder(arguments, folder, dict(os.environ))


def test_capture_has_the_poses_of_the_model_and_hides_doubles_without_a_pose() -> None:
    found = capture(load_scene("impedance_push"), fps=10, seconds=1.0)
    assert found.frames == 11
    assert np.allclose(np.linalg.norm(found.rotations, axis=2), 1.0)
    turns = (found.rotations[1:] * found.rotations[:-1]).sum(axis=2)
    assert (turns > 0).all()
    assert np.abs(found.positions).max() < 10


def test_part_of_a_run_begins_at_the_requested_time() -> None:
    whole = capture(load_scene("impedance_push"), fps=10, seconds=1.0)
    part = capture(load_scene("impedance_push"), fps=10, begin=0.5, seconds=0.3)
    assert part.frames == 4
    assert np.array_equal(part.values["torques"], whole.values["torques"][5:9], equal_nan=True)
    last = capture(load_scene("impedance_push"), fps=10, begin=4.5, seconds=9.0)
    assert last.frames == 6


def test_too_long_run_is_rejected_before_capture_with_the_maximum_duration() -> None:
    with pytest.raises(RenderError) as error:
        capture(load_scene("impedance_push"), seconds=36_000.0)
    most = float(str(error.value).split("at most ")[1].split(" s")[0])
    assert 600 < most < 36_000


def test_poses_are_stored_within_half_a_step() -> None:
    found = capture(load_scene("impedance_push"), fps=10, seconds=1.0)
    data = encode(found, "push")
    size = int.from_bytes(data[:4], "little")
    head = json.loads(data[4 : 4 + size])
    part, kind, count = head["positions"]
    start = 4 + size + sum(head["lengths"][:part])
    planes = np.frombuffer(data, np.uint8, head["lengths"][part], start)
    folded = planes.reshape(-1, count).T.copy().view(f"<{kind}").ravel().astype(np.int64)
    steps = np.cumsum(((folded >> 1) ^ -(folded & 1)).reshape(-1, found.frames), axis=1)
    stored = (steps * head["steps"][0]).T.reshape(found.positions.shape)
    assert np.abs(stored - found.positions).max() <= head["steps"][0] / 2 + 1e-9
    assert len(zlib.compress(data)) < 100_000


def test_marks_are_what_was_done_found_and_expected() -> None:
    scene = load_scene("impedance_push")
    capture(scene, fps=10)
    marks = marks_of(scene)
    assert [(m.begin, m.end, m.text) for m in marks if m.kind == "push"] == [(1.0, 3.0, "push")]
    expected = scene.sources["simulation"].run.scenario.expect
    assert {m.kind for m in marks if ": " in m.text} <= {"held", "failed", "finding"}
    assert len([m for m in marks if m.kind in ("held", "failed")]) == len(expected)
    assert marks_of(scene, 3.5) != marks


def test_legend_has_the_scale_of_an_arrow_while_it_is_visible() -> None:
    scene = load_scene("impedance_push")
    scene.note = "a note"
    found = capture(scene, fps=10, begin=0.5, seconds=3.0)
    assert set(found.notes) == {"a note"}
    is_told = np.array(["push: 80 mm long = 20 N" in text for text in found.legend])
    push, _ = [item for item in found.items if item.kind == Kind.VECTOR]  # shaft and head
    assert np.array_equal(is_told, push.visible)
    assert 0 < is_told.sum() < found.frames and not is_told[-1]
    assert all("round arrows: joint torque\n" in text for text in found.legend)


def test_only_world_decor_is_stored() -> None:
    found = capture(load_scene("stewart"), seconds=0.1, wait=0.0)
    assert found.silent == ["udp"]
    assert all((item.rows["emission"] < 1.0).all() for item in found.items)
    assert "no data" in found.notes[-1]


def test_page_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError) as error:
        write_page(capture(load_scene("lwr")), tmp_path / "none" / "lwr.html")
    assert "lwr.html" in str(error.value)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["lwr"], "-o"),
        (["lwr", "a.html", "-o", "b.html"], "-o"),
        (["lwr", "-o", "a.pdf"], ".html"),
        (["lwr", "-o", "a.xml", "--fps", "3"], "--fps"),
        (["impedance_push", "-o", "a.html", "--from", "3", "--to", "2"], "--to"),
        (["impedance_push", "-o", "a.html", "--seconds", "3", "--to", "2"], "--seconds"),
    ],
)
def test_export_refuses_what_does_not_go_together(
    arguments: list[str], word: str, tmp_path: Path
) -> None:
    status, said = run_command("export", *arguments, folder=tmp_path)
    assert status == 2
    assert word in said


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a run."""
    folder = tmp_path_factory.mktemp("recorded")
    run_command("simulate", "impedance_push", "--record", "run.mcap", folder=folder)
    return folder / "run.mcap"


@pytest.mark.thorough
def test_recording_is_exported_with_its_own_scene_even_if_truncated(
    tmp_path: Path, whole: Path
) -> None:
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(whole.read_bytes()[: int(0.8 * whole.stat().st_size)])
    for file in (whole, torn):
        page = tmp_path / f"{file.stem}.html"
        status, said = run_command("export", str(file), "-o", str(page), folder=tmp_path)
        assert status == 0, said
        assert page.stat().st_size < 600_000


def test_recording_without_an_intact_packet_leaves_no_page(tmp_path: Path, whole: Path) -> None:
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(whole.read_bytes()[:30_000])
    status, said = run_command("export", str(torn), "-o", "torn.html", folder=tmp_path)
    assert status == 2 and "no valid packet" in said
    assert not (tmp_path / "torn.html").exists()


@pytest.mark.parametrize("what", ["test", "compare"])
def test_javascript_unit_tests_pass_and_the_bundle_is_up_to_date(
    what: str, node_modules: Path
) -> None:
    done = subprocess.run([ROOT / ".ci" / "js", what], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.thorough
def test_report_has_a_page_a_figure_json_and_a_test_for_each_expectation(tmp_path: Path) -> None:
    setting = "expect.final_flange_travel.below=0.00001"
    status, said = run_command(
        "simulate", "impedance_push", "--report", "report", "--set", setting, folder=tmp_path
    )
    assert status == 1, said
    folder = tmp_path / "report"
    assert {file.name for file in folder.iterdir()} == {
        "index.html", "torques.png", "report.json", "junit.xml",
    }  # fmt: skip
    outcomes = json.loads((folder / "report.json").read_text())["expect"]
    suite = ElementTree.parse(folder / "junit.xml").getroot()[0]
    assert suite.get("tests") == str(len(outcomes)) and suite.get("failures") == "1"
    (failed,) = (case for case in suite if case.find("failure") is not None)
    assert failed.get("name") == "final_flange_travel"


@pytest.mark.thorough
def test_report_without_matplotlib_lacks_only_its_figure(tmp_path, monkeypatch, caplog) -> None:
    monkeypatch.setattr(run_report, "find_spec", lambda _: None)
    run_report.write_report(simulated(800.0), tmp_path, {})
    made = {file.name for file in tmp_path.iterdir()}
    assert made == {"index.html", "report.json", "junit.xml"}
    assert "pip install 'sero-mj[figures]'" in caplog.text


@pytest.mark.thorough
def test_page_of_two_runs_shows_the_second_as_a_double(tmp_path: Path, whole: Path) -> None:
    run_command(
        "simulate", "impedance_push", "--record", "b.mcap", "--set",
        "controllers.lwr.stiffness=400", folder=tmp_path,
    )  # fmt: skip
    status, said = run_command(
        "compare", str(whole), "b.mcap", "-o", "compare.html", "--quiet", folder=tmp_path
    )
    assert status == 0, said
    assert (tmp_path / "compare.html").stat().st_size < 1_000_000
    text = (tmp_path / "compare.html").read_text()
    (run,) = re.findall('id="run">([^<]*)<', text)
    head = zlib.decompress(base64.b64decode(run), -15)
    assert b"round arrows: difference of torques, A - B" in head
    assert b"commanded - measured" not in head and b'"quantities":[]' in head
    meant = json.dumps({"A": str(whole), "B": "b.mcap"}, separators=(",", ":"))
    assert f'"meanings":{meant}'.encode() in head
