"""Files from strangers: nothing in them runs unless the user has trusted them."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from page_client import PageClient
from scripted_widgets import ScriptedWidgets
from test_cli import run

import sero_mj
from sero_mj import Mirror, load_scene, read_scenario
from sero_mj.base import trust
from sero_mj.base.errors import DeclarationError, NotTrusted, UnknownName
from sero_mj.robots.importers.urdf import read_urdf
from sero_mj.simulate.external_control.program_controller import UdpProgram
from sero_mj.simulate.simulation import Simulation
from sero_mj.viewer.host.other_scenes import OtherScenes
from sero_mj.viewer.web import browsers
from sero_mj.viewer.web.host import WebHost

PROGRAM = 'kind = "udp"\ncommand = ["sh", "-c", "echo > ran; exit 9", "x", "{port}"]'
LIBRARY = 'kind = "library"\nfile = "evil.so"'
SCENARIO = """
[robots.lwr]
model = "lwr"
[controllers.lwr]
{controller}
[run]
duration = 0.05
"""
EVIL = """
#include <stdio.h>
__attribute__((constructor)) static void begin(void) { fclose(fopen("{ran}", "w")); }
void control(void *robot) {}
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compiles a library whose constructor creates the file `ran` beside it."""
    if shutil.which("cc") is None:
        pytest.skip("needs a C compiler")
    folder = tmp_path_factory.mktemp("evil")
    (folder / "evil.c").write_text(EVIL.replace("{ran}", str(folder / "ran")))
    subprocess.run(["cc", "-shared", "-fPIC", "evil.c", "-o", "evil.so"], cwd=folder, check=True)
    return folder


def with_program(folder: Path) -> Path:
    file = folder / "evil.toml"
    file.write_text(SCENARIO.format(controller=PROGRAM))
    return file


def with_library(folder: Path) -> Path:
    file = folder / "evil.toml"
    file.write_text(SCENARIO.format(controller=LIBRARY))
    return file


PASSIVE = {
    "check": ("check", "{file}"),
    "render": ("render", "{file}", "-o", "{out}/a.png"),
    "render a video": ("render", "{file}", "-o", "{out}/a.gif", "--duration", "0.1"),
    "fk": ("check", "--fk", "{file}"),
    "convert": ("convert", "{file}", "{out}/a.x3d"),
    "export": ("export", "{file}", "-o", "{out}/a.html", "--seconds", "0.1"),
    "schema": ("check", "--schema", "scenario"),
    "list": ("list",),
    "status": ("status", "{file}", "--seconds", "0.1"),
}


@pytest.mark.parametrize(
    "command",
    [
        pytest.param(each, marks=[pytest.mark.slow] * each.startswith(("render", "export")))
        for each in PASSIVE
    ],
)
def test_commands_that_only_show_a_file_run_nothing(command: str, library, tmp_path, capsys):
    for make, folder in ((with_program, tmp_path), (with_library, library)):
        words = [word.format(file=make(folder), out=tmp_path) for word in PASSIVE[command]]
        run(capsys, *words)
        assert not (folder / "ran").exists()


def test_check_reports_the_program_a_scenario_would_run(tmp_path, capsys):
    status, out, _ = run(capsys, "check", str(with_program(tmp_path)))
    assert status == 0
    assert "asks to run the program sh -c 'echo > ran; exit 9' x '{port}' (controllers.lwr)" in out


def test_check_reports_errors_in_a_scenario_it_does_not_run(tmp_path, capsys):
    file = tmp_path / "wrong.toml"
    missing = PROGRAM.replace('"sh"', '"./missing"')
    motion = "\n[targets.lwr]\nkind = 'constant'\nangles = [0, 9, 0]"
    file.write_text(SCENARIO.format(controller=missing) + motion)
    status, _, err = run(capsys, "check", str(file))
    assert status == 2
    assert "controllers.lwr.command" in err
    assert "targets.lwr" in err


def test_simulate_runs_the_scenario_named_by_the_user_and_reports_it(tmp_path, capsys):
    _, _, err = run(capsys, "simulate", str(with_program(tmp_path)))
    assert (tmp_path / "ran").exists()
    assert "will run the program sh -c" in err


@pytest.mark.extensions
def test_sweep_reports_the_program_it_runs(tmp_path, capsys):
    options = ("--vary", "run.seed=1,2", "--jobs", "1")
    _, _, err = run(capsys, "sweep", str(with_program(tmp_path)), *options)
    assert (tmp_path / "ran").exists()
    assert err.count("will run the program sh -c") == 1


def recording_with(file: Path, folder: Path) -> Path:
    """Writes a recording of a simulation with another scenario in place of its own."""
    own = folder / "own.toml"
    plain = SCENARIO.format(controller='kind = "gravity_compensation"')
    own.write_text(plain.replace("0.05", "0.6"))
    subprocess.run(
        [sys.executable, "-m", "sero_mj", "simulate", "own.toml", "--record", "own.mcap"],
        cwd=folder,
        check=True,
        capture_output=True,
    )
    gift = folder / "elsewhere" / "gift.mcap"
    gift.parent.mkdir()
    with (folder / "own.mcap").open("rb") as opened, gift.open("wb") as written:
        reader, writer = make_reader(opened), Writer(written)
        summary, header = reader.get_summary(), reader.get_header()
        assert summary is not None
        writer.start(header.profile, header.library)
        schemas = {0: 0} | {
            key: writer.register_schema(each.name, each.encoding, each.data)
            for key, each in summary.schemas.items()
        }
        channels = {
            key: writer.register_channel(
                each.topic, each.message_encoding, schemas[each.schema_id], each.metadata
            )
            for key, each in summary.channels.items()
        }
        for about in reader.iter_metadata():
            writer.add_metadata(about.name, about.metadata)
        for each in reader.iter_attachments():
            data = file.read_bytes() if each.name.endswith("own.toml") else each.data
            writer.add_attachment(each.create_time, each.log_time, each.name, each.media_type, data)
        for _, channel, message in reader.iter_messages():
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time
            )
        writer.finish()
    own.unlink()
    return gift


@pytest.mark.slow
def test_recording_is_played_and_its_scenario_never_runs(tmp_path, capsys, monkeypatch):
    gift = recording_with(with_program(tmp_path), tmp_path)
    made: list[object] = []
    monkeypatch.setattr(Simulation, "__init__", lambda *given, **more: made.append(given))
    for words in (
        ("render", str(gift), "-o", str(tmp_path / "a.png"), "--at", "0.02"),
        ("export", str(gift), "-o", str(tmp_path / "a.html")),
        ("check", str(gift)),
        ("compare", str(gift)),
    ):
        status, _, err = run(capsys, *words)
        assert status == 0, (words, err)
    assert not made
    assert not list(tmp_path.rglob("ran"))
    assert (tmp_path / "a.png").stat().st_size > 1000


def test_scene_of_an_untrusted_scenario_does_not_move(tmp_path):
    file = with_program(tmp_path)
    scene = load_scene(file)
    assert scene.sources == {}
    assert scene.withheld is not None
    assert [action.key for action in scene.withheld.actions] == ["controllers.lwr"]
    assert load_scene(file, trusted=True).withheld is None
    assert not (tmp_path / "ran").exists()  # the program starts with the first step


def test_only_a_trusted_scenario_can_be_simulated(tmp_path):
    file = with_program(tmp_path)
    with pytest.raises(NotTrusted) as refused:
        Simulation(read_scenario(file, trusted=False))
    assert refused.value.file == file
    assert "sh -c" in refused.value.actions[0]
    Simulation(read_scenario(file))  # the user names it


def test_controller_with_other_gains_has_the_same_origin(tmp_path):
    scenario = read_scenario(with_program(tmp_path), trusted=False)
    declared = scenario.controllers["lwr"]
    assert declared.changed({"patience": 2.0}).origin == declared.origin


def test_controller_declared_in_python_is_trusted(tmp_path):
    declared = UdpProgram(command=["sh", "-c", "exit 0", "x", "{port}"])
    assert declared.origin is None
    trust.require(declared.origin, declared.actions())


def test_request_is_allowed_for_its_exact_contents(tmp_path):
    script = tmp_path / "control.sh"
    script.write_text("exit 9")
    script.chmod(0o755)
    file = tmp_path / "own.toml"
    controller = 'kind = "udp"\ncommand = ["./control.sh", "{port}"]'
    file.write_text(SCENARIO.format(controller=controller))
    request = load_scene(file).withheld
    assert request is not None
    assert request.actions[0].files == (script,)
    trust.allow(request)
    assert load_scene(file).withheld is None
    script.write_text("rm -r *")
    assert load_scene(file).withheld is not None
    script.write_text("exit 9")
    assert load_scene(file).withheld is None
    file.write_text(file.read_text() + "seed = 3\n")
    assert load_scene(file).withheld is not None


def test_scenario_that_extends_another_requests_both(tmp_path):
    with_program(tmp_path)
    file = tmp_path / "more.toml"
    file.write_text('extends = "evil.toml"\n[set]\n"run.seed" = 2\n')
    request = load_scene(file).withheld
    assert request is not None
    trust.allow(request)
    assert load_scene(file).withheld is None
    with_program(tmp_path).write_text(SCENARIO.format(controller=PROGRAM.replace("9", "8")))
    assert load_scene(file).withheld is not None


def test_trusted_folder_covers_its_contents_only(tmp_path, monkeypatch):
    monkeypatch.setattr(trust, "_folders", set())
    (tmp_path / "mine").mkdir()
    (tmp_path / "others").mkdir()
    mine, other = with_program(tmp_path / "mine"), with_program(tmp_path / "others")
    trust.trust_folder(tmp_path / "mine")
    assert load_scene(mine).withheld is None
    assert load_scene(other).withheld is not None
    script = tmp_path / "others" / "control.sh"
    script.write_text("")
    script.chmod(0o755)
    controller = 'kind = "udp"\ncommand = ["../others/control.sh", "{port}"]'
    mine.write_text(SCENARIO.format(controller=controller))
    assert load_scene(mine).withheld is not None


def test_dialog_names_the_program_and_allows_it_on_this_machine_only(tmp_path):
    request = load_scene(with_program(tmp_path)).withheld
    assert request is not None
    closed: list[bool] = []
    others = OtherScenes(lambda text, is_bad: None, lambda: closed.append(True))
    others.ask(request, lambda: None)  # type: ignore[arg-type, return-value]
    far = ScriptedWidgets({"run and simulate": True})
    others.build_dialog(far, can_allow=False)
    assert any("sh -c" in text for text in far.texts())
    assert not closed
    assert not trust.is_allowed(request)
    others.build_dialog(ScriptedWidgets({"run and simulate": True}), can_allow=True)
    assert closed
    assert trust.is_allowed(request)


XACRO = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="arm">
<xacro:property name="value" value="{expression}"/>
<link name="base"/><link name="tip"/>
<joint name="j" type="revolute"><parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>
<origin xyz="${{value}} 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>
"""


@pytest.mark.parametrize(
    "expression",
    [
        "${(lambda: ().__class__.__base__.__subclasses__())()}",
        "${[c for c in ().__class__.__base__.__subclasses__()][0]}",
        "${'{0.__class__}'.format(1)}",
        "${f'{1 .__class__}'}",
        "${python.type(1)}",
        "${python.vars(xacro)}",
        "${math.__loader__}",
        "${xacro.load_yaml.__globals__}",
        "${xacro.load_yaml.func_globals}",
        "${__import__('os').system('true')}",
        "$(eval __import__('os').system('true'))",
        "$(eval (lambda: 1)())",
        "${9**9**9}",
        "${'a' * 10**9}",
        "${python.len(python.list(python.range(10**12)))}",
    ],
)
def test_xacro_expressions_cannot_run_python(expression: str, tmp_path):
    pytest.importorskip("xacro")
    file = tmp_path / "arm.urdf.xacro"
    file.write_text(XACRO.format(expression=expression))
    with pytest.raises(DeclarationError):
        read_urdf(file)


@pytest.mark.parametrize(
    "expression",
    [
        "${0.1 + 2 * 0.3 - sin(pi / 6)}",
        "${math.radians(45) if 3 > 2 and not False else 0}",
        "${max([x * 0.1 for x in [1, 2, 3] if x != 2])}",
        "${dict(a=0.5, b=[0.25])['b'][0]}",
        "${xacro.load_yaml('limits.yaml')['arm'].reach}",
        "${xacro.load_yaml('limits.yaml').arm.angle}",
        "${len('abc'.upper()) * 1e-1}",
        "$(eval scale * 2)",
        "$(eval 0.5 if scale > 0 else 1)",
        "${min(0.3, 2**-3)}",
    ],
)
def test_xacro_expressions_have_the_values_of_xacro(expression: str, tmp_path):
    xacro = pytest.importorskip("xacro")
    pytest.importorskip("simpleeval")
    from sero_mj.robots.importers.xacro_file import expand

    (tmp_path / "limits.yaml").write_text("arm: {reach: 0.75, angle: !degrees 30.0}\n")
    file = tmp_path / "arm.urdf.xacro"
    argument = '<xacro:arg name="scale" default="0.2"/><xacro:property'
    text = XACRO.format(expression=expression).replace("<xacro:property", argument, 1)
    file.write_text(text)
    expected = xacro.process_file(str(file)).toxml()
    assert expand(file, {}, lambda package: package) == expected
    assert 'xyz="${' not in expected


def test_module_named_in_a_file_is_imported_only_if_listed_by_its_package():
    assert trust.import_listed("json", "decoder", ["decoder"]).__name__ == "json.decoder"
    with pytest.raises(UnknownName) as refused:
        trust.import_listed("json", "tool", ["decoder"])
    assert refused.value.name == "tool"


@pytest.mark.extensions
def test_type_names_in_a_bag_are_not_executed(tmp_path, capsys):
    """rosbags makes classes from them with `exec`."""
    pytest.importorskip("rosbags")
    ran = tmp_path / "ran"
    file = tmp_path / "evil.mcap"
    name = f"a/msg/B:\n    open({str(ran)!r}, 'w')\nclass C"
    with file.open("wb") as opened:
        writer = Writer(opened)
        writer.start("ros2", "test")
        schema = writer.register_schema(name, "ros2msg", b"float64 x\n")
        channel = writer.register_channel("/joint_states", "cdr", schema)
        writer.add_message(channel, 10**9, b"\0\1\0\0" + bytes(8), 10**9)
        writer.finish()
    status, _, _ = run(capsys, "check", str(file))
    assert status != 0
    assert not ran.exists()


# Code that starts a program, loads code or evaluates text, and why it needs no trust.
_GUARDED: dict[str, str] = {
    "base/trust.py": "asks whether the package lists the module",
    "base/child_process.py": "starts what others ask for, see below",
    "cli/doctor.py": "our own probes",
    "robots/importers/mjcf_file.py": "MuJoCo's own library",
    "extensions/fmu/fmu.py": "made by make_controller, which asks",
    "simulate/external_control/library.py": "made by make_controller, which asks",
    "simulate/external_control/library_host.py": "started by library.py",
    "simulate/mujoco_timers.py": "MuJoCo's own library",
    "extensions/sweeps/scenario_inputs.py": "reads, with our interpreter, what the user simulates",
    "viewer/image/backend.py": "our own probes",
    "extensions/filament/probe.py": "our own probes",
    "viewer/program/process.py": "our own viewer",
    "viewer/program/process_main.py": "messages of the process that has started it",
    "__init__.py": "our own modules",
}
_CALLS = {
    "Popen", "system", "CDLL", "LoadLibrary", "exec", "eval", "extract", "import_module",
    "resolve_name", "process_file", "run_path", "run_module", "__import__", "execv", "execvp",
    "spawn", "posix_spawn",
}  # fmt: skip
_MODULES = {"subprocess", "pickle", "runpy", "marshal", "shelve"}


def _starts_something(node: ast.AST) -> bool:
    if isinstance(node, ast.Call):
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        of = getattr(getattr(node.func, "value", None), "id", "")
        is_system_library = name == "CDLL" and all(
            isinstance(each, ast.Constant) and each.value is None for each in node.args
        )
        is_rule = of == "re" or (name == "extract" and of != "fmpy")
        return (name in _CALLS and not is_rule and not is_system_library) or of in _MODULES
    return False


@pytest.mark.slow
def test_every_place_that_starts_a_program_or_loads_code_is_listed():
    root = Path(sero_mj.__file__).parent
    found = {
        file.relative_to(root).as_posix()
        for file in root.rglob("*.py")
        if "snippets" not in file.parts
        and any(_starts_something(node) for node in ast.walk(ast.parse(file.read_text())))
    }
    assert found == {*_GUARDED, "robots/importers/xacro_file.py"}


def test_make_controller_requires_trust_first(tmp_path, monkeypatch):
    made: list[object] = []
    monkeypatch.setattr(UdpProgram, "make", lambda *given: made.append(given))
    with pytest.raises(NotTrusted):
        Simulation(read_scenario(with_program(tmp_path), trusted=False))
    assert not made


def button_of(state: dict[str, Any], label: str) -> str | None:
    """Returns the id of a button in the dialog of a page."""
    todo = [*((state.get("request") or {}).get("nodes", ()))]
    while todo:
        node = todo.pop()
        if isinstance(node, dict):
            if label in node.values():
                return str(node["id"])
            todo += node.values()
        elif isinstance(node, list):
            todo += node
    return None


@pytest.mark.parametrize("is_near", [True, False])
def test_only_a_browser_on_this_machine_can_allow_a_file(is_near: bool, tmp_path, monkeypatch):
    scene = load_scene(with_program(tmp_path))
    request = scene.withheld
    assert request is not None
    shown: list[str] = []
    with Mirror(scene) as mirror, WebHost(mirror, folder=tmp_path) as page:
        page.others.ask(request, lambda: shown.append("simulated"))  # type: ignore[arg-type, return-value]
        with PageClient(page) as near:
            near.until(lambda: button_of(near.state, "run and simulate"))
            run_it = button_of(near.state, "run and simulate")
            if not is_near:
                monkeypatch.setattr(browsers, "is_local", lambda connection: False)
                with PageClient(page) as far:
                    far.say("control")
                    far.until(lambda: not button_of(far.state, "run and simulate"))
                    for _ in range(3):
                        far.say("widget", tree="request", id=run_it, value=True)
                    far.until(lambda: page._input.wrong == 3)
                    assert not trust.is_allowed(request)
                    assert shown == []
                    show_only = button_of(far.state, "display only")
                    assert show_only  # it can see what the file requests
                return
            near.say("widget", tree="request", id=run_it, value=True)
            near.until(lambda: shown)
            assert trust.is_allowed(request)
            assert not page.is_open  # the next page shows the simulation


def test_scenario_needs_permission_to_send_to_the_network(tmp_path):
    """A robot controller that listens there could mistake a state for a command."""
    file = tmp_path / "far.toml"
    file.write_text(SCENARIO.format(controller='kind = "udp"\nhost = "192.0.2.7"\nport = 30200'))
    request = load_scene(file).withheld
    assert request is not None
    assert "192.0.2.7:30200" in request.actions[0].text


@pytest.mark.extensions
def test_scenario_needs_permission_to_join_a_ros_network(tmp_path):
    file = tmp_path / "far.toml"
    file.write_text(SCENARIO.format(controller='kind = "ros2"\ndomain = 7'))
    request = load_scene(file).withheld
    assert request is not None
    assert "domain 7" in request.actions[0].text


def test_dialog_shows_characters_that_would_hide_a_command(tmp_path):
    file = tmp_path / "hidden.toml"
    command = PROGRAM.replace("echo > ran", "\\u202e nar > ohce \\u0007")
    file.write_text(SCENARIO.format(controller=command))
    request = load_scene(file).withheld
    assert request is not None
    others = OtherScenes(lambda text, is_bad: None, lambda: None)
    others.ask(request, lambda: None)  # type: ignore[arg-type, return-value]
    ui = ScriptedWidgets()
    others.build_dialog(ui, can_allow=True)
    (shown,) = [text for text in ui.texts() if "ohce" in text]
    assert r"\u202e nar > ohce \x07" in shown


def test_only_the_shown_contents_are_allowed(tmp_path):
    """A program that changes while the dialog is open is requested again."""
    script = tmp_path / "control.sh"
    script.write_text("exit 9")
    script.chmod(0o755)
    file = tmp_path / "own.toml"
    for command in ('["./control.sh", "{port}"]', '["sh", "control.sh", "{port}"]'):
        script.write_text("exit 9")
        file.write_text(SCENARIO.format(controller=f'kind = "udp"\ncommand = {command}'))
        request = load_scene(file).withheld
        assert request is not None
        script.write_text("rm -r *")
        trust.allow(request)
        assert load_scene(file).withheld is not None


def test_program_is_named_by_its_path(tmp_path):
    script = tmp_path / "control.sh"
    script.write_text("")
    script.chmod(0o755)
    command = UdpProgram(command=["./control.sh", "{port}"], folder=tmp_path)
    (action,) = command.actions("controllers.lwr")
    assert str(script) in action.text


@pytest.mark.parametrize("word", ["x" * 300, "true;" * 100, "a/" * 3000, "a\\u0000b"])
def test_words_that_are_not_file_names_are_plain_arguments(word: str, tmp_path, capsys):
    file = tmp_path / "long.toml"
    for command in (f'["sh", "-c", "{word}", "{{port}}"]', f'["./{word}", "{{port}}"]'):
        file.write_text(SCENARIO.format(controller=f'kind = "udp"\ncommand = {command}'))
        status, _, err = run(capsys, "check", str(file))
        assert status == (0 if '"-c"' in command else 2), err


def test_command_cannot_forge_output_lines(tmp_path, capsys):
    file = tmp_path / "forged.toml"
    command = PROGRAM.replace("exit 9", "exit 9\\n  model   10 bodies\\n")
    file.write_text(SCENARIO.format(controller=command))
    _, out, _ = run(capsys, "check", str(file))
    assert len([line for line in out.splitlines() if line.startswith("  model")]) == 1
    assert r"exit 9\n  model" in out


def test_failing_file_does_not_end_the_viewer():
    messages: list[tuple[str, bool]] = []
    others = OtherScenes(lambda text, is_bad: messages.append((text, is_bad)), lambda: None)

    def fails(path: Path) -> Mirror:
        raise OSError(36, "File name too long")

    others.opener = fails
    assert not others.open_file(Path("a.toml"))
    assert messages[0][1]
    assert "File name too long" in messages[0][0]


def test_program_ends_with_the_view_of_its_run(tmp_path):
    file = tmp_path / "mine.toml"
    command = 'kind = "udp"\ncommand = ["sh", "-c", "echo $$ > pid; sleep 99", "x", "{port}"]'
    scenario = SCENARIO.format(controller=f"{command}\non_silence = 'gravity_compensation'\n")
    file.write_text(scenario.replace("0.05", "50"))
    with Mirror(load_scene(file, {"controllers.lwr.first_patience": 0.2}, trusted=True)) as mirror:
        mirror.advance(0.01)
        pid = int((tmp_path / "pid").read_text())
        os.kill(pid, 0)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
