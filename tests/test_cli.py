"""The command line as a user meets it: exit status, one clear line, no traceback."""

import json
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import av
import mujoco
import numpy as np
import pytest
from PIL import Image

from sero_mj.base.paths import find_scene
from sero_mj.cli import GROUPS, doctor, main, translated, view
from sero_mj.cli.arguments import overrides

COMMANDS = ["view", "render", "demo", "status", "record", "send", "structure", "simulate", "new",
            "compare", "plot", "check", "export", "import", "list",
            "sweep", "identify", "calibrate"]  # fmt: skip
OF_EXTENSIONS = ("sweep", "identify", "calibrate")


def run(capsys, *arguments: str) -> tuple[int, str, str]:
    """Exit status, output and errors of a command, run in this process."""
    with pytest.raises(SystemExit) as exit_:
        main(list(arguments))
    out, err = capsys.readouterr()
    return int(exit_.value.code or 0), out, err


def sero_mj(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """A command in a process of its own."""
    command = [sys.executable, "-m", "sero_mj", *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=100, check=False, cwd=cwd
    )


@pytest.mark.parametrize(
    "command",
    [
        pytest.param(each, marks=[pytest.mark.extensions] * (each in OF_EXTENSIONS))
        for each in COMMANDS
    ],
)
def test_every_command_has_help_with_examples(command: str, capsys) -> None:
    status, out, _ = run(capsys, command, "--help")
    assert status == 0
    assert len(out.splitlines()) > 8
    assert f"usage: sero-mj {command}" in out
    _, _, after = out.partition("\nexamples:\n")
    examples, _, _ = after.partition("\n\n")
    assert len(re.findall(rf"^  sero-mj {command}\b", examples, re.MULTILINE)) == 3
    assert "\noptions:\n" in after


@pytest.mark.extensions
def test_main_help_lists_all_commands(capsys) -> None:
    status, out, _ = run(capsys, "--help")
    assert status == 0
    assert re.findall(r"^(\w+):$", out, re.MULTILINE)[:5] == [*GROUPS]
    for command in COMMANDS:
        assert re.search(rf"^  {command}\s+\w", out, re.MULTILINE)
    assert len(out.splitlines()) <= 45
    assert max(map(len, out.splitlines())) <= 100


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("export-csv a.mcap b.csv --start=1 --stop 2", "export a.mcap b.csv --from=1 --to 2"),
        ("convert fig7.x3d a.toml", "export fig7.x3d a.toml"),
        ("fk lwr --deg", "check --fk lwr --deg"),
        ("schema robot -o a.json", "check --schema robot -o a.json"),
        ("doctor --json", "check --json"),
        ("snippet c --scene", "new --snippet c --scene"),
        ("ros2 list --domain 4 --json", "status ros2://:4 --topics --json"),
    ],
)
def test_old_names_of_commands_work_with_a_note(old: str, new: str, capsys) -> None:
    assert translated(old.split()) == new.split()
    assert "is now 'sero-mj" in capsys.readouterr().err
    assert translated(new.split()) == new.split()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["render", "lwr_ud", "-o", "x.png"],
            "no scene or robot 'lwr_ud'; did you mean 'lwr_udp'?",
        ),
        (
            ["render", "lwr", "-o", "x.svg"],
            "--output: found 'x.svg'; expected a name that ends in .png, .jpg, .jpeg, .webp for an "
            "image, or .mp4, .webm, .gif for a video",
        ),
        (
            ["render", "lwr", "-o", "x.npy"],
            "-o x.npy: '.npy' needs --pass; expected a name that ends in .png",
        ),
        (
            ["render", "lwr", "-o", "x.png", "--fps", "3"],
            "--fps needs a video (.mp4, .webm, .gif)",
        ),
        (["render", "lwr", "-o", "x.png", "--size", "12"], "expected WIDTHxHEIGHT, e.g. 1280x800"),
        (["render", "lwr", "-o", "x.png", "--camera", "top"], "no camera 'top'"),
        (["render", "lwr", "-o", "x.png", "--set", "show_axes"], "expected ROBOT.FIELD=VALUE"),
        (["render", "lwr_udp", "-o", "x.png", "--set", "lw.show_axes=true"], "did you mean 'lwr'"),
        (["render", "lwr_udp", "-o", "x.png", "--set", "lwr.show_axis=true"], "'show_axes'?"),
        (
            ["render", "lwr", "-o", "x.png", "--set", "lwr.torques=1,2"],
            "found 2 entries",
        ),
        (["render", "lwr", "-o", "x.mp4", "--duration", "nan"], "expected a number above 0"),
        (["check", "--fk", "lwr", "--joint-angles", "1,2"], "found 2 numbers, but lwr has 7"),
        (
            ["check", "--fk", "lwr", "--joint-angles", "1,x"],
            "found '1,x'; expected numbers separated by commas",
        ),
        (["check", "--fk", "lrw"], "no scene or robot 'lrw'; did you mean 'lwr'?"),
        (
            ["send", "lwr_udp", "--structure", "6F6F"],
            "values0 has 6 values, but lwr.joint_angles takes 7",
        ),
        (["send", "lwr_udp", "--structure", "7G"], "structure '7G', character 2: found 'G'"),
        (
            ["send", "lwr_udp", "--source", "ucp"],
            "the scene has no source 'ucp'; did you mean 'udp'?",
        ),
        (["send", "lwr_udp", "--rate", "0"], "expected a number above 0"),
        (["send", "lwr_udp", "--port", "70000"], "expected a port from 1 to 65535"),
        (["export", "lwr", "lwr.urdf"], "expected a name that ends in .csv"),
        (["check", "nothing.toml"], "nothing.toml: no such file"),
        (
            ["render", "lwr", "-o", "x.mp4", "--size", "1x1"],
            "size: found [1, 1]; expected at least 2",
        ),
        (["render", "lwr", "-o", "x.png", "--wait", "-1"], "expected a number of 0 or more"),
        (["render", "lwr", "-o", "x.mp4", "--duration", "1e9"], "expected at most 1000000"),
        (["render", "lwr", "-o", "/proc/no/x.mp4"], "cannot write /proc/no/x.mp4"),
        (["render", "lwr", "-o", "/proc/no/x.png"], "cannot write /proc/no/x.png"),
        (["send", "lwr", "--rate", "1e9"], "expected at most 100000 packets/s"),
        (["render", "lwr", "-o", "x.png", "--set", "lwe.show_axes=true"], "did you mean 'lwr'?"),
        (["render", "lwr", "-o", "x.png", "--set", "lwr.model=lwr"], "cannot be overridden"),
        pytest.param(
            ["dance"],
            "no command 'dance'; available: calibrate, check",
            marks=pytest.mark.extensions,
        ),
        (["view", "--camera", "0,0,1"], "--camera needs a scene: sero-mj view SCENE"),
        (["view", "--set", "lwr.show_axes=true"], "--set needs a scene"),
    ],
)
def test_bad_use_exits_with_2_and_one_clear_line(
    arguments, said, capsys, tmp_path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    status, out, err = run(capsys, *arguments)
    assert status == 2
    assert said in err
    assert "Traceback" not in out + err
    assert len(err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_nearest_file_of_the_folder_is_suggested(capsys, tmp_path) -> None:
    (tmp_path / "two_arms.toml").write_text("")
    status, _, err = run(capsys, "check", str(tmp_path / "tow_arms.toml"))
    assert status == 2
    assert "tow_arms.toml: no such file; did you mean 'two_arms.toml'?" in err


def test_values_that_begin_with_a_minus_need_no_equals_sign(capsys) -> None:
    status, out, _ = run(
        capsys, "check", "--fk", "lwr", "--joint-angles", "-.1,0,0,0,0,0,0", "--json"
    )
    assert status == 0
    assert json.loads(out)["joint_angles"][0] == -0.1
    status, _, err = run(capsys, "render", "lwr", "-o", "x.png", "--camera", "-90,-20,-3")
    assert "camera: found '-90,-20,-3'; expected the name of a camera, or azimuth" in err


@pytest.mark.thorough
@pytest.mark.gl
def test_interrupted_video_is_saved(tmp_path) -> None:
    film = tmp_path / "film.mp4"
    command = [sys.executable, "-u", "-m", "sero_mj", "render", "lwr", "-o", str(film)]
    process = subprocess.Popen(
        [*command, "--size", "160x120", "--duration", "1000"],
        stderr=subprocess.PIPE,
        text=True,
        # A shell starts what it runs in the background with this signal ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # noqa: PLW1509
    )
    assert process.stderr is not None
    part = tmp_path / ".film.mp4.part.mp4"
    deadline = time.monotonic() + 60
    while not (part.exists() and part.stat().st_size > 0):  # the encoder writes after a while
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    frames = re.search(r"film.mp4 contains the first (\d+) frames", err)
    assert frames, err
    assert "Traceback" not in err
    with av.open(str(film)) as container:
        assert abs(sum(1 for _ in container.decode(video=0)) - int(frames[1])) <= 1
    assert not part.exists()


def test_all_problems_of_a_scene_are_printed_at_once(capsys, tmp_path) -> None:
    scene = tmp_path / "bad.toml"
    scene.write_text(
        '[robots.lwr]\nmodel = "lwr"\nshow_arow = true\n\n[sources.udp]\nkind = "upd"\n'
        '[routes]\n"lwr.joint_angels" = "udp.values0"\n'
    )
    status, _, err = run(capsys, "check", str(scene))
    assert status == 2
    assert "3 errors" in err or "2 errors" in err
    assert f"{scene}:3: robots.lwr.show_arow: unknown key; did you mean 'show_arrows'?" in err
    assert f"{scene}:6: sources.udp.kind: no kind 'upd'; did you mean 'udp'?" in err
    assert "; did you mean 'udp'?" in err


def test_fk_prints_both_routes_and_their_difference(capsys) -> None:
    status, out, _ = run(
        capsys, "check", "--fk", "lwr", "--deg", "--joint-angles", "0,30,0,-90,0,60,0", "--json"
    )
    assert status == 0
    result = json.loads(out)
    # ROBOTS.md, regression pose from two URDF chains.
    assert np.array(result["dh"])[:3, 3] == pytest.approx([-0.537750, 0, 0.383410], abs=1e-6)
    assert np.array(result["mujoco"]) == pytest.approx(np.array(result["dh"]), abs=1e-12)
    assert result["position_difference"] < 1e-12
    assert result["angle_difference"] < 1e-12
    status, out, _ = run(capsys, "check", "--fk", "lwr")
    assert "difference: " in out


def test_check_prints_the_contents_of_a_scene(capsys) -> None:
    status, out, _ = run(capsys, "check", "lwr_udp")
    assert status == 0
    assert "robot   lwr: 7 joints, craig DH, meshes" in out
    assert "source  udp: UDP 127.0.0.1:32000, 112 bytes: values0 (7), values1 (7)" in out
    assert "route   udp.values1 -> lwr.torques" in out


def test_check_prints_which_objects_are_free(capsys) -> None:
    _, out, _ = run(capsys, "check", "hit_hand_grasp")
    assert "object  can: 0.2 kg, free in simulation\n" in out
    assert "object  table\n" in out


def test_check_prints_route_expressions(capsys, tmp_path) -> None:
    file = tmp_path / "s.toml"
    scene = '[robots.lwr]\nmodel = "lwr"\n[sources.udp]\nkind = "udp"\nstructure = "9F"\n[routes]\n'
    routes = '"lwr.joint_angles" = "udp.values0[2:] * deg"\n"lwr.torques" = 0.5\n'
    file.write_text(scene + routes)
    status, out, _ = run(capsys, "check", str(file))
    assert status == 0
    assert "route   udp.values0[2:] * deg -> lwr.joint_angles" in out
    assert "route   0.5 -> lwr.torques" in out
    file.write_text(scene + routes.replace("deg", "mm"))
    status, _, err = run(capsys, "check", str(file))
    assert status == 2
    message = "udp.values0[2:] * mm is a length (m), but lwr.joint_angles takes an angle (rad)"
    assert f"s.toml:7: routes.lwr.joint_angles: {message}" in err


@pytest.mark.extensions
def test_list_names_robots_scenes_and_fields(capsys) -> None:
    _, out, _ = run(capsys, "list")
    assert "lwr_udp" in out and "light-weight robot" in out
    assert re.search(r"^  impedance_push +Joint impedance holds", out, re.MULTILINE)
    assert re.search(
        r"^  lwr/reach +Move the flange to a random reachable target", out, re.MULTILINE
    )
    robots = out.partition("robots (models/)\n")[2].partition("\nscenes (")[0].splitlines()
    robots.remove("groups of robots (models/)")
    assert all(row[20] == " " and row[21] != " " for row in robots), robots  # in a column
    assert any(row.split()[0] == "dlr_hand2" for row in robots)
    _, out, _ = run(capsys, "list", "--fields")
    assert re.search(r"^axes_size = 0.2\n    length of the axes in m", out, re.MULTILINE)
    assert "dh_convention = required" in out


def test_export_is_loaded_by_plain_mujoco(capsys, tmp_path) -> None:
    path = tmp_path / "folder" / "lwr.xml"
    status, out, _ = run(capsys, "export", "lwr_udp", str(path))
    assert status == 0
    assert "24 mesh files" in out
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.key("home").qpos == pytest.approx(np.zeros(7))
    assert model.body("lwr/flange").id > 0


@pytest.mark.gl
def test_render_sets_fields_over_the_scenes(capsys, tmp_path) -> None:
    plain, posed = tmp_path / "plain.png", tmp_path / "posed.png"
    options = ["--size", "160x120", "--wait", "0"]
    status, _, err = run(capsys, "render", "lwr_udp", "-o", str(plain), *options)
    assert status == 0
    assert "no valid packet from source 'udp' within 0 s" in err
    settings = ["--set", "lwr.joint_angles=0,1,0,-1.5,0,1,.5", "--set", "lwr.torques=9,9,9,9,9,9,9"]
    status, out, err = run(capsys, "render", "lwr_udp", "-o", str(posed), *options, *settings)
    assert (status, err, out.strip()) == (0, "", str(posed))  # nothing is left to receive
    a, b = (np.asarray(Image.open(path), int) for path in (plain, posed))
    assert a.shape == (120, 160, 3)
    assert (np.abs(a - b).max(axis=2) > 60).sum() > 200


@pytest.mark.thorough
@pytest.mark.gl
def test_click_in_an_image_shows_the_same_as_in_a_window(capsys, caplog, tmp_path) -> None:
    plain, clicked = tmp_path / "plain.png", tmp_path / "clicked.png"
    options = ["--size", "320x240", "--camera", "150,-14,2.2"]
    run(capsys, "render", "lwr", "-o", str(plain), *options)
    status, _, _ = run(capsys, "render", "lwr", "-o", str(clicked), *options, "--click", "160,150")
    assert status == 0
    assert re.search(r"click at 160,150: link lwr/link\d", caplog.text)
    a, b = (np.asarray(Image.open(path), int) for path in (plain, clicked))
    assert (np.abs(a - b).max(axis=2) > 60).sum() > 500  # a billboard
    run(capsys, "render", "lwr", "-o", str(clicked), *options, "--click", "2,2")
    assert "click at 2,2: no item" in caplog.text
    status, _, err = run(capsys, "render", "lwr", "-o", str(clicked), "--click", "2")
    assert status == 2
    assert "expected X,Y in pixels, or X,Y followed by ,shift ,double ,hover or ,touch" in err


def test_settings_are_toml_or_numbers_with_commas() -> None:
    got = overrides(
        ["a.x=true", "a.y=1,-.5", "a.z=[1, 2]", "a.w=word", 'a.v="1"', "a.u={xyz=[1,2,3]}"]
    )
    assert got == {
        "a.x": True,
        "a.y": [1.0, -0.5],
        "a.z": [1, 2],
        "a.w": "word",
        "a.v": "1",
        "a.u": {"xyz": [1, 2, 3]},
    }


@pytest.mark.slow
def test_send_and_render_meet_on_a_port_of_their_own_processes(tmp_path) -> None:
    scene = tmp_path / "scene.toml"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    scene.write_text(find_scene("lwr_udp").read_text().replace("32000", str(port)))
    sender = subprocess.Popen(
        [sys.executable, "-m", "sero_mj", "send", str(scene)], stdout=subprocess.DEVNULL
    )
    try:
        film = tmp_path / "film.mp4"
        done = sero_mj(
            "render", str(scene), "-o", str(film), "--duration", "0.5", "--fps", "10",
            "--size", "160x120", "--wait", "30",
        )  # fmt: skip
    finally:
        sender.terminate()
        sender.wait()
    assert done.returncode == 0, done.stderr
    assert "no packet" not in done.stderr
    assert film.stat().st_size > 1000


def test_port_in_use_is_reported_before_anything_opens(tmp_path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        port = holder.getsockname()[1]
        scene = tmp_path / "scene.toml"
        scene.write_text(
            f'[robots.lwr]\nmodel="lwr"\n[sources.udp]\nkind="udp"\nport={port}\nstructure="7F"\n'
            '[routes]\n"lwr.joint_angles"="udp.values0"\n'
        )
        done = sero_mj("render", str(scene), "-o", str(tmp_path / "x.png"))
    assert done.returncode == 2
    assert done.stderr.strip() == (
        f"sero-mj: source 'udp': UDP port {port} on 127.0.0.1 is in use by another program. "
        "Close it, or choose another port"
    )
    assert not (tmp_path / "x.png").exists()


def test_command_works_from_any_directory(tmp_path) -> None:
    done = sero_mj("check", "--fk", "lwr", "--json", cwd=tmp_path)
    assert done.returncode == 0
    assert json.loads(done.stdout)["position_difference"] < 1e-12


@pytest.mark.thorough
@pytest.mark.slow
def test_check_tests_every_backend_and_suggests_packages(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    done = sero_mj("check", "--json")
    found = json.loads(done.stdout)
    assert set(found["backends"]) == {"egl", "osmesa", "glfw"}
    assert found["backends"][found["chosen"]]["works"]
    assert done.returncode == 0
    times = found["frame_times"]
    assert 0 < times["draft"] < times["normal"]
    assert found["live"]["page"] is None
    # As text, without being measured again.
    monkeypatch.setattr(doctor, "try_backend", found["backends"].get)
    monkeypatch.setattr(doctor, "frame_times", {found["chosen"]: times}.get)
    with pytest.raises(SystemExit) as ended:
        main(["check"])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    for name, backend in found["backends"].items():
        line = next(line for line in text.splitlines() if f"  {name} " in line)
        assert ("works: " in line) == backend["works"]
    assert "one 1280x800 frame of an LWR with egl: normal " in text
    assert ("slow for live views" in text) != ("fast enough" in text)
    assert "sero-mj view: page available" in text
    assert ("chrt -f 50" in text) == found["fifo"] != ("rtprio" in text)
    where = "available" if found["live"]["window"] is None else "unavailable: neither DISPLAY"
    assert f"sero-mj view: window {where}" in text
    if not all(backend["works"] for backend in found["backends"].values()):
        assert "apt install" in text


def test_commands_import_only_what_they_run_with() -> None:
    code = (
        "import sys; from sero_mj.cli import main\n"
        "try:\n    main(['--help'])\n"
        "except SystemExit:\n"
        "    heavy = {'mujoco', 'av', 'matplotlib', 'rich', 'cv2', 'PIL', 'trimesh'}\n"
        "    print(heavy & sys.modules.keys(), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "examples" in done.stdout or "To try it" in done.stdout
    assert done.stderr == "set()\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["new", "arm"], "cannot write arm: No such file or directory"),
        (
            ["check", "--schema", "robot", "-o", "no/robot.json"],
            "cannot write no: No such file or directory",
        ),
    ],
)
def test_unwritable_output_is_reported(
    arguments: list[str], said: str, capsys, monkeypatch
) -> None:
    monkeypatch.chdir("/proc")
    status, _, err = run(capsys, *arguments)
    assert (status, err) == (2, f"sero-mj: {said}\n")


def test_all_errors_of_options_are_reported_at_once(capsys) -> None:
    status, _, err = run(capsys, "render", "lwr", "-o", "x.png", "--size", "9", "--wait", "x")
    assert status == 2
    assert err.splitlines() == [
        "sero-mj: 2 errors:",
        "  --size: found '9'; expected WIDTHxHEIGHT, e.g. 1280x800",
        "  --wait: found 'x'; expected a number of 0 or more",
    ]


def test_closed_pipe_ends_without_a_message() -> None:
    command = f"{sys.executable} -m sero_mj list --fields | head -1"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.stderr == ""


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("lwr.show_arrow=true", "lwr.show_arrow: unknown key; did you mean 'show_arrows'?"),
        ("lwr.joint_angles=1,2", "lwr.joint_angles: found 2 entries; expected 7, one per row of"),
        ('lwr.billboard_lines=[{value="torques", decimal=1}]',
         "lwr.billboard_lines.0.decimal: unknown key; did you mean 'decimals'?"),
        ("lrw.show_axes=true", "lrw.show_axes: no robot 'lrw' to set this for; did you mean"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("scene", ["lwr_udp", "lwr"])
def test_invalid_overrides_are_reported_with_their_option(
    scene: str, setting: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["render", scene, "-o", str(tmp_path / "x.png"), "--set", setting])
    assert caught.value.code == 2
    if scene == "lwr":  # there is one robot only
        message = message.replace(" to set this for", "")
    assert capsys.readouterr().err.startswith(f"sero-mj: --set {message}")


def test_check_names_what_no_route_takes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(
        '[robots.lwr]\nmodel = "lwr"\n\n'
        '[sources.udp]\nkind = "udp"\nstructure = "n:1I t:1F 7F7F mode:1H"\nsequence = "n"\n'
        'time = "t"\n\n[sources.other]\nkind = "udp"\nstructure = "3F"\n\n'
        '[routes]\n"lwr.joint_angles" = "udp.values0 * deg"\n'
    )
    _, out, _ = run(capsys, "check", str(file))
    assert "            not used: values1, mode\n" in out
    assert out.count("no route uses it") == 1
    assert "not used" not in run(capsys, "check", "lwr_fri")[1]
    assert "not used" not in run(capsys, "check", "lwr_udp")[1]


def test_start_page_is_shown_without_a_command(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = []
    monkeypatch.setattr(view.Session, "choose", lambda session: shown.append(session.options))
    monkeypatch.setattr("sero_mj.viewer.image.backend.has_display", lambda: True)
    for arguments in ([], ["view"]):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 0
    assert [each.scene for each in shown] == [None, None]
    with pytest.raises(SystemExit):
        main(["--web", "--port", "8177"])
    assert shown[2].port == 8177


ROBOT = """
dh_convention = "craig"
dh_params = [[0.0, 0.0, 0.0, 0.35], [1.5708, 0.0, 0.0, 0.0], [0.0, 0.4, 0.0, 0.0]]
"""


@pytest.mark.parametrize("unit", ["", "_deg"])
def test_robot_file_with_any_name_is_a_robot(unit: str, tmp_path, capsys):
    file = tmp_path / "crane.toml"
    file.write_text(ROBOT.replace("params", f"params{unit}"))
    status, out, _ = run(capsys, "check", str(file))
    assert status == 0
    assert "robot   crane: 3 joints" in out
    status, _, told = run(capsys, "simulate", str(file))
    assert status == 2 and f"{file} is a robot; expected a scenario" in told


@pytest.mark.parametrize("word", ["True", "FALSE"])
def test_python_booleans_get_a_hint(word: str, tmp_path, capsys):
    file = tmp_path / "scene.toml"
    file.write_text(f'[robots.lwr]\nmodel = "lwr"\nshow_arrows = {word}\n')
    status, _, err = run(capsys, "check", str(file))
    assert status == 2
    assert f"write {word.lower()} in lower case" in err


def test_run_without_expectations_reports_so(tmp_path, capsys):
    file = tmp_path / "scene.toml"
    file.write_text('[robots.lwr]\nmodel = "lwr"\n[run]\nduration = 0.01\n')
    status, out, _ = run(capsys, "simulate", str(file))
    assert status == 0
    assert "no expectations" in out
