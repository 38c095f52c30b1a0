"""Files that would take unlimited time or memory: pipes, infinite devices, keys and sums."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from conftest import raises_with
from shm_tools import block, needs_posix

from sero_mj import Scene, SerialRobot, load_scene
from sero_mj.base.errors import (
    DeclarationError,
    RecordingError,
    RenderError,
    RouteError,
    SourceError,
)
from sero_mj.base.paths import (
    find_group_model,
    find_model,
    find_scenario,
    find_scene,
    open_file,
    read_file,
)
from sero_mj.base.toml_file import key_lines, read_toml
from sero_mj.cli import main
from sero_mj.data.drive.language import parse
from sero_mj.data.receive.shm import ShmReader
from sero_mj.data.record.recording import Recording
from sero_mj.data.record.replay import Replay
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.surroundings import Object
from sero_mj.robots.importers.mjcf_file import as_spec
from sero_mj.robots.importers.urdf import read_urdf
from sero_mj.simulate.runs.run_recording import read_run

__all__ = ["block"]  # a fixture
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="there are no such files")
ROBOT = '[robots.{}]\ndh_convention = "craig"\ndh_params = [[0, 0, 0, 0.2]]\n'


@pytest.fixture(autouse=True)
def bounded() -> Iterator[None]:
    """Ends a process that takes all memory or hangs, before it ends the machine."""
    import resource

    def late(*_: Any) -> None:
        raise TimeoutError("it hangs")

    before = resource.getrlimit(resource.RLIMIT_DATA)
    # In addition to stacks and models that remain from previous tests.
    resource.setrlimit(resource.RLIMIT_DATA, (_data_bytes() + 4 * 2**30, before[1]))
    handler = signal.signal(signal.SIGALRM, late)
    signal.alarm(20)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, handler)
        resource.setrlimit(resource.RLIMIT_DATA, before)


def _data_bytes() -> int:
    """Returns the size of this process's data, or 0 if Linux does not report it."""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return 0
    return int(status.partition("VmData:")[2].split()[0]) * 1024


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    """Returns a pipe that nobody writes to."""
    os.mkfifo(tmp_path / "pipe.mcap")
    return tmp_path / "pipe.mcap"


@pytest.fixture
def endless(tmp_path: Path) -> Callable[[str], Path]:
    def link(name: str) -> Path:
        (tmp_path / name).symlink_to("/dev/zero")
        return tmp_path / name

    return link


def test_files_above_the_size_limit_and_special_files_are_not_opened(
    tmp_path: Path, pipe: Path
) -> None:
    (tmp_path / "long").write_bytes(b"")
    os.truncate(tmp_path / "long", 10**12)  # sparse
    with pytest.raises(OSError, match=r"found 1000000\.0 MB; expected at most 1 MB"):
        read_file(tmp_path / "long", 10**6)
    with pytest.raises(OSError, match="found a pipe; expected a file"):
        open_file(pipe)
    with pytest.raises(OSError, match="found a device"):
        open_file("/dev/zero")
    with pytest.raises(IsADirectoryError):
        open_file(tmp_path)
    (tmp_path / "short").write_bytes(b"abc")
    assert read_file(tmp_path / "short", 3) == b"abc"


def test_pipe_is_rejected_as_recording(pipe: Path, capsys: pytest.CaptureFixture[str]) -> None:
    expected = f"{pipe} cannot be read: found a pipe; expected a file"
    for opened in (Recording, read_run):
        with pytest.raises(RecordingError) as found:
            opened(pipe)
        assert str(found.value) == expected
    with raises_with(key="file", reason=expected):
        Replay(name="r", file=pipe)
    for command in (
        ["render", "lwr_udp", "-o", str(pipe.with_suffix(".png")), "--replay", str(pipe)],
        ["compare", str(pipe), str(pipe)],
        ["export", str(pipe), str(pipe.with_suffix(".csv"))],
        ["send", "lwr_udp", "--play", str(pipe)],
    ):
        with pytest.raises(SystemExit) as ended:
            main(command)
        assert ended.value.code == 2
        assert f"sero-mj: {expected}" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["x.toml", "x.urdf", "x.x3d", "x.png", "x"])
def test_pipe_is_reported_where_a_file_is_expected(tmp_path: Path, name: str) -> None:
    """A pipe used to be reported as missing, with its own name as the suggestion."""
    os.mkfifo(tmp_path / name)
    expected = f"{tmp_path / name} cannot be read: found a pipe; expected a file"
    for find in (find_scene, find_scenario, find_model, find_group_model):
        with pytest.raises(DeclarationError) as found:
            find(str(tmp_path / name))
        assert str(found.value) == expected


@pytest.mark.extensions
def test_pipes_are_rejected_as_photos_videos_and_points(pipe: Path) -> None:
    from sero_mj.extensions.photo.calibration import read_points
    from sero_mj.extensions.photo.footage import Video, read_photo

    reason = "found a pipe; expected a file"
    for read, what in ((read_photo, "cannot be read"), (Video, "is not a readable video")):
        with raises_with(RenderError, reason=f"{pipe} {what}: {reason}"):
            read(pipe)
    points = pipe.rename(pipe.with_suffix(".csv"))
    with raises_with(file=str(points), reason=f"cannot be read: {reason}"):
        read_points(points, World(Scene()), (100, 100))


@needs_posix
@pytest.mark.skipif(sys.platform != "linux", reason="blocks are no files there")
def test_pipe_is_rejected_as_shared_memory(block: str) -> None:
    os.mkfifo(f"/dev/shm/{block}")
    try:
        with (
            raises_with(
                SourceError,
                source="shm",
                reason=f"shared memory {block}: it is a special file, not shared memory",
            ),
            ShmReader(block=block, structure="1F"),
        ):
            pass
    finally:
        os.unlink(f"/dev/shm/{block}")


@pytest.mark.extensions
def test_infinite_meshes_mjcf_files_and_tables_are_rejected(
    tmp_path: Path, endless: Callable[[str], Path]
) -> None:
    endless("mesh.stl"), endless("piece.xml")
    for field, file, what in (
        ("mesh", "mesh.stl", "mesh"),
        ("mjcf", "piece.xml", "cannot be read:"),
    ):
        scene = Scene(objects=[Object(name="o", directory=str(tmp_path), **{field: file})])
        reason = f"{what} {tmp_path / file}: found a device; expected a file"
        with raises_with(key=f"objects.o.{field}", reason=reason):
            World(scene)
    with raises_with(
        key="mjcf", reason=f"cannot be read: {tmp_path}/nothing.xml: No such file or directory"
    ):
        as_spec("nothing.xml", tmp_path)
    with raises_with(
        reason="cannot be read: found a device; expected a file", file=f"{tmp_path}/scene.toml"
    ):
        read_toml(endless("scene.toml"))


@pytest.mark.parametrize("key", ["a.", 'a . "b" .', "'a'.", "[a.", "x = { a."])
def test_keys_with_thousands_of_dots_are_rejected(tmp_path: Path, key: str) -> None:
    """Such keys took memory quadratic in their length."""
    file = tmp_path / "x.toml"
    start, dotted = (key[:-2], key[-2:]) if key[-2] == "a" else ("", key)
    file.write_text(f"b = 1\n{start}{dotted * 20_000}c = 1\n")
    with pytest.raises(DeclarationError) as found:
        read_toml(file)
    expected = "not valid TOML: expected at most 100 parts of a dotted key (at line 2)"
    assert str(found.value) == f"{file}:2: {expected}"


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("many", "what"),
    [
        ("a{}.b.c.d = 1\n", "100000 keys and tables"),
        ("[[a]] # {}\n", "100000 keys and tables"),
        ("[a{}.b]\n", "100000 keys and tables"),
        ("'{}'.b = 1\n", "100000 keys and tables"),
        ("x = [1, 2, 3, 4, 5, {}]\n", "100000 keys and tables"),
        ("# {}\n0,\n1, 2, 3, 4,", "2000000 values"),
        ("['{}'], [1, 2], true,\n", "2000000 values"),
    ],
)
def test_files_with_too_many_keys_or_values_are_rejected_before_they_are_read(
    tmp_path: Path, many: str, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files of 9 MB took minutes and gigabytes before an unknown section was reported."""
    file = tmp_path / "x.toml"
    rows = 600_000 if what.endswith(" values") else 101_000
    file.write_text("x = [\n" + "".join(many.format(i) for i in range(rows)))
    loads = "sero_mj.base.toml_file.tomllib.loads"
    monkeypatch.setattr(loads, lambda text: pytest.fail("it is read"))
    with pytest.raises(DeclarationError, match=rf"expected at most {what} \(at line \d+\)"):
        read_toml(file)


def test_text_that_looks_like_keys_is_not_counted(tmp_path: Path) -> None:
    file = tmp_path / "x.toml"
    rows = "  [1.5],\n" * 60_000 + "  ['a.b', 2.5, # c = d\n],\n" * 60_000
    text = "[x]\na = b\n" * 60_000
    dots = "a." * 200
    file.write_text(f'"{dots}" = "{dots}"\npath = [\n{rows}]\ntext = """\n{text}"""\n')
    assert read_toml(file).keys() == {dots, "path", "text"}


def test_long_arrays_and_texts_are_read_quickly(tmp_path: Path) -> None:
    file = tmp_path / "x.toml"
    rows = "  [1, 2, 3, 4, 5, 6, 7],\n" * 20_000
    word = "a" * 1_000_000
    file.write_text(f'path = [\n{rows}]\nword = "{word}" # {word}\n[t]\nlast = """\n]{word}"""\n')
    begin = time.process_time()
    assert len(read_toml(file)["path"]) == 20_000
    lines = key_lines(file)
    assert (lines["path"], lines["word"], lines["t.last"]) == (1, 20_003, 20_005)
    assert time.process_time() - begin < 5.0


def test_expressions_of_thousands_of_terms_are_rejected() -> None:
    text = " + ".join(["udp.values0"] * 20_000)
    begin = time.process_time()
    with pytest.raises(RouteError) as found:
        parse(text)
    assert time.process_time() - begin < 2.0
    message = str(found.value)
    assert "expected at most 2000 numbers, names and signs; found 39999" in message
    assert (
        "character 14001: found 'udp.values0'" in message or "character 14001: found '+'" in message
    )
    assert len(message) < 500
    assert parse(" + ".join(["udp.values0"] * 900))


def test_scenes_of_too_many_robots_are_rejected_before_they_are_built(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = SerialRobot(dh_convention="craig", dh_params=[[0, 0, 0, 0.2]])
    many = [one.model_copy(update={"name": f"r{i}"}) for i in range(201)]
    with raises_with(key="robots", found=201):
        Scene(robots=many)
    Scene(robots=many[:200])

    def built(*_: Any) -> None:
        pytest.fail("an entry is built")

    monkeypatch.setattr("sero_mj.robots.declared.scene_file._SceneReader._entry", built)
    file = tmp_path / "many.toml"
    file.write_text("".join(ROBOT.format(f"r{i}") for i in range(3000)))
    with pytest.raises(DeclarationError) as found:
        load_scene(file)
    assert str(found.value) == f"{file}:1: robots: found 3000 entries; expected at most 200"
    file.write_text("floor = true\n" + "".join(f"[lights.l{i}]\n" for i in range(101)))
    with pytest.raises(DeclarationError) as found:
        load_scene(file)
    assert str(found.value) == f"{file}:2: lights: found 101 entries; expected at most 100"


def test_nested_group_models_do_not_multiply(tmp_path: Path) -> None:
    """Eight files of ten groups each would be 100 million robots."""
    for depth in range(8):
        (tmp_path / f"m{depth}").mkdir()
        inner = "".join(f'[groups.g{i}]\nmodel = "m{depth + 1}"\n' for i in range(10))
        text = ROBOT.format("r") if depth == 7 else inner
        (tmp_path / f"m{depth}" / "group.toml").write_text(text)
    (tmp_path / "scene.toml").write_text('[groups.all]\nmodel = "m0"\n')
    with raises_with(key="groups", found=108):
        load_scene(tmp_path / "scene.toml")


def test_doubles_of_large_groups_do_not_multiply(tmp_path: Path) -> None:
    names = [f"r{i}" for i in range(150)]
    robots = "".join(map(ROBOT.format, names)) + f"[groups.all]\nrobots = {names}\n"
    doubles = "".join(f'[doubles.d{i}]\nof = "all"\n' for i in range(4))
    file = tmp_path / "x.toml"
    file.write_text(robots + doubles + "[routes]\n'd0.joint_angles' = [0]\n")
    with pytest.raises(DeclarationError) as found:
        load_scene(file)
    assert [(each.key, each.message) for each in found.value.problems] == [
        ("doubles", "found 600 entries; expected at most 500")
    ]


def test_too_long_routes_and_too_many_children_are_rejected(tmp_path: Path) -> None:
    file = tmp_path / "x.toml"
    children = 'children = [{ name = "c", shape = "sphere" },' + "{}," * 2000 + "]\n"
    file.write_text(ROBOT.format("a") + children + f"[routes]\n'x.y' = \"{'+1' * 100_000}\"\n")
    with pytest.raises(DeclarationError) as found:
        load_scene(file)
    assert [(each.key, each.message) for each in found.value.problems] == [
        ("robots.a.children", "found 2001 entries; expected at most 2000"),
        ("routes.x.y", "found 200000 characters; expected at most 100000"),
    ]


def test_infinite_meshes_in_mjcf_are_rejected(
    tmp_path: Path, endless: Callable[[str], Path]
) -> None:
    endless("mesh.stl")
    text = (
        '<mujoco><asset><mesh name="m" file="mesh.stl"/></asset><worldbody>'
        '<geom type="mesh" mesh="m"/></worldbody></mujoco>'
    )
    with raises_with(
        key="mjcf", reason=f"cannot be read: {tmp_path}/mesh.stl: found a device; expected a file"
    ):
        as_spec(text, tmp_path)


def test_urdf_of_too_many_links_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "chain.urdf"
    links = "".join(f"<link name='l{k}'/>" for k in range(10_001))
    path.write_text(f"<robot name='r'>{links}</robot>")
    with raises_with(key="robot", reason="found 10001 links; expected at most 10000", line=1):
        read_urdf(path)


@pytest.mark.parametrize("how", ["geoms", "replicate", "include"])
def test_mjcf_of_too_many_elements_is_rejected(how: str, tmp_path: Path) -> None:
    many = "<geom size='1'/>" * 20_001
    geoms = {
        "geoms": many,
        "replicate": "<replicate count='20001'><geom size='1'/></replicate>",
        "include": "<include file='more.xml'/>",
    }[how]
    (tmp_path / "more.xml").write_text(f"<mujocoinclude>{many}</mujocoinclude>")
    text = f"<mujoco><worldbody>{geoms}</worldbody></mujoco>"
    (tmp_path / "whole.xml").write_text(text)
    what = "has too many bodies, geoms and sites; expected at most 20,000"
    for source in (text, "whole.xml"):
        with raises_with(key="mjcf", reason=f"cannot be read: {what}"):
            as_spec(source, tmp_path)
