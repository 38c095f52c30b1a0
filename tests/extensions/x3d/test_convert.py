"""`sero-mj export`: X3D scenes as TOML and back, and losses on the way."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from conftest import ROOT
from hypothesis import given
from hypothesis import strategies as st

from sero_mj import Scene, SerialRobot, World, load_scene
from sero_mj.cli import main
from sero_mj.extensions.x3d.export import robot_table
from sero_mj.extensions.x3d.reader import read_x3d
from sero_mj.extensions.x3d.writer import x3d_text
from sero_mj.robots.importers.toml_text import toml_text

FIG7 = ROOT / "tests" / "fig7.x3d"
CELL = """#X3D V3.0 utf8
WorldInfo { title "A \\"cell\\"" }
DEF front Viewpoint { position 0.9 1.2 3 orientation -0.8 0.5 0 0.4 fieldOfView 0.6 }
DEF top Viewpoint { position 0 5 0 orientation 1 0 0 -1.5707963267948966 }
DEF sun DirectionalLight { direction -0.3 -1 -0.4 intensity 0.5 color 1 0.5 0.25 }
DEF spot SpotLight { location 1 2 3 direction 0 -1 0 }
DEF table Shape { geometry Box { size 1 0.05 0.8 }
  appearance Appearance { material Material { diffuseColor .65 .45 .25 transparency 0.25 } } }
Transform { translation 0.3 0.125 0.2 rotation 1 2 3 0.5 children [
  DEF can Shape { geometry Cylinder { radius 0.05 height 0.2 } }
  Transform { scale 1 2 3 children DEF egg Shape { geometry Sphere { radius 0.05 } } }
  DEF ball Shape { geometry Sphere { radius 0.05 } }
  DEF hat Shape { geometry Cone { bottomRadius 0.25 height 0.5 }
    appearance Appearance { material Material { diffuseColor 1 0 0 } } }
] }
Transform { rotation 1 0 0 -1.5707963267948966 children DEF arm SerialRobot {
  dhParams [ 0 0 0 0.31, 1.5708 0.1 0 0 ] jointAngles [0.3 0.6] showAxes TRUE
  name "the arm" directory "meshes\\\\of it" filenames ["a.wrl" "" "b.wrl"]
  flangeFrame 0 1 0 0 -1 0 0 0 0 0 1 0 0.1 0.2 0.3 1
  offsetsToCenterOfJoints [0 0 0.1, 0.5 0 0]
  children [ DEF tool Shape { geometry Box { size .1 .1 .1 } }
    DEF hand SerialRobot { dhParams [ 0 0 0 .1 ] baseFrame 1 0 0 0 0 1 0 0 0 0 1 0 0 0 .05 1 } ]
} }
DEF udp UdpReceiver { structure "2F2F" udpport 4711 isDouble FALSE host "0.0.0.0" }
DEF memory ShmReader { structure "1F" block "hand" scale 0.5 }
ROUTE udp.values0 TO arm.jointAngles
ROUTE udp.values1 TO arm.torques
ROUTE udp.receiving TO arm.showArrows
ROUTE memory.values0 TO hand.jointAngles
ROUTE arm.jointAngles TO arm.billboardValues
"""


def convert(scene: Path | str, output: Path) -> None:
    with pytest.raises(SystemExit) as done:
        main(["export", str(scene), str(output)])
    assert done.value.code == 0


def close(a: Any, b: Any) -> bool:
    """Returns whether tables are equal up to rounding."""
    if isinstance(a, dict) and isinstance(b, dict):
        return {*a} == {*b} and all(close(a[key], b[key]) for key in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(close, a, b))
    if isinstance(a, float | int) and isinstance(b, float | int):
        return abs(a - b) < 1e-9
    return bool(a == b)


def test_fig_7_survives_conversion_to_toml(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    convert(FIG7, tmp_path / "scene.toml")
    text = (tmp_path / "scene.toml").read_text()
    assert text.startswith("# Converted from fig7.x3d.\n# Note: missing geometry files base")
    assert tomllib.loads(text) == read_x3d(FIG7).tables
    convert(tmp_path / "scene.toml", tmp_path / "again.x3d")
    assert "cannot express" not in capsys.readouterr().err
    again = read_x3d(tmp_path / "again.x3d")
    assert again.warnings == [] and again.tables == read_x3d(FIG7).tables
    assert (
        'EXTERNPROTO UdpReceiver [] "PROTO_udpReceiver.wrl"' in (tmp_path / "again.x3d").read_text()
    )


def test_whole_scene_survives_conversion(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    x3d, folder = tmp_path / "cell.x3d", tmp_path / "meshes" / "of it"
    x3d.write_text(CELL)
    folder.mkdir(parents=True)
    for name in ("a.wrl", "b.wrl"):
        (folder / name).write_text("#VRML V2.0 utf8\nShape { geometry Box { size .1 .1 .1 } }")
    tables = read_x3d(x3d).tables
    assert tables["robots"]["arm"]["directory"] == "meshes/of it"
    (tmp_path / "scenes").mkdir()
    convert(x3d, tmp_path / "scenes" / "cell.toml")
    toml = tomllib.loads((tmp_path / "scenes" / "cell.toml").read_text())
    assert toml["robots"]["arm"].pop("directory") == "../meshes/of it"
    assert tables["robots"]["arm"].pop("directory")
    assert toml == tables
    capsys.readouterr()
    convert(tmp_path / "scenes" / "cell.toml", tmp_path / "again.x3d")
    err = capsys.readouterr().err
    assert err.split("of the scene: ")[1] == "sources.udp.host\n"
    again = read_x3d(tmp_path / "again.x3d").tables
    del tables["sources"]["udp"]["host"]
    assert again["robots"]["arm"].pop("directory") == "meshes/of it"
    for section in ("robots", "sources", "routes", "cameras", "lights", "view"):
        assert close(again[section], tables[section])
    assert {*again["objects"]} == {*tables["objects"]}
    for name, table in tables["objects"].items():
        if "mjcf" not in table:
            assert close(again["objects"][name], table)
    hats = [World(load_scene(path)).model for path in (x3d, tmp_path / "again.x3d")]
    vertices = [
        model.mesh_vert[model.mesh_vertadr[k] :][: model.mesh_vertnum[k]]
        for model in hats
        for k in [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_MESH, "hat/m0")]
    ]
    assert np.allclose(*vertices, atol=1e-6)


def test_written_links_match_drawn_links(tmp_path: Path) -> None:
    toml = tmp_path / "own.toml"
    toml.write_text("""
[robots.arm]
dh_convention = "craig"
dh_params = [[0, 0, 0, 0.3]]
filenames = [
  [{ shape = "capsule", size = [0.05, 0.2], color = "red", frame = { xyz = [0, 0.1, 0] } },
   { shape = "ellipsoid", size = [0.1, 0.2, 0.3] }, { shape = "sphere", size = [0.1] }],
  [{ shape = "cylinder", size = [0.05, 0.2], frame = { rpy = [0.4, 0.5, 0] } },
   { shape = "box", size = [0.1, 0.2, 0.3], frame = { xyz = [0.5, 0, 0] } }],
]
colors = { red = [1.0, 0.0, 0.0, 0.5] }
""")
    for scene, output in (("lwr", "lwr.x3d"), (toml, "own.x3d")):
        convert(scene, tmp_path / output)
        models = [World(load_scene(str(each))).model for each in (scene, tmp_path / output)]
        for ours, theirs in zip(*map(_drawn, models), strict=True):
            assert ours.keys() == theirs.keys()
            for color, (low, high) in ours.items():  # round shapes have 32 sides in files
                assert np.allclose(low, theirs[color][0], atol=3e-3)
                assert np.allclose(high, theirs[color][1], atol=3e-3)


def _drawn(model: mujoco.MjModel) -> list[dict[tuple[float, ...], Any]]:
    """Returns, for every link, the bounding box of its drawn geoms by color."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    links: list[dict[tuple[float, ...], Any]] = []
    for body in range(1, model.nbody):
        boxes: dict[tuple[float, ...], Any] = {}
        for k in np.flatnonzero(model.geom_bodyid == body):
            points = _points(model, int(k)) @ data.geom_xmat[k].reshape(3, 3).T + data.geom_xpos[k]
            color = tuple(model.geom_rgba[k].round(4).tolist())
            low, high = boxes.get(color, (points[0], points[0]))
            boxes[color] = (
                np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0)),
            )  # fmt: skip
        if boxes:
            links.append(boxes)
    return links


def _points(model: mujoco.MjModel, k: int) -> Any:
    """Returns points on a geom in its frame."""
    size, kind = model.geom_size[k], mujoco.mjtGeom(model.geom_type[k]).name[7:].lower()
    if kind == "mesh":
        first = model.mesh_vertadr[model.geom_dataid[k]]
        return model.mesh_vert[first : first + model.mesh_vertnum[model.geom_dataid[k]]]
    ball = np.random.default_rng(0).normal(size=(20_000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    ends = np.array([[0, 0, size[1]], [0, 0, -size[1]]])
    if kind == "capsule":
        return np.concatenate([ball * size[0] + end for end in ends])
    if kind == "cylinder":
        ring = ball[:, :2] / np.linalg.norm(ball[:, :2], axis=1, keepdims=True) * size[0]
        return np.concatenate([np.column_stack([ring, np.zeros(len(ring))]) + end for end in ends])
    if kind == "box":
        return np.sign(ball) * size
    return ball * (size if kind == "ellipsoid" else size[0])


def test_standard_table_becomes_craigs_with_the_same_flange_and_centers(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    robot = SerialRobot(
        name="r",
        dh_convention="standard",
        dh_params=rng.uniform(-1, 1, (5, 4)),
        flange_frame={"xyz": [0.1, 0.2, 0.3], "rpy": [0.4, 0.5, 0.6]},
        offsets_to_center_of_joints=rng.uniform(-0.3, 0.3, (5, 3)),
    )
    text, left_out = x3d_text({"robots": {"r": robot_table(robot, Path("out.x3d"), {})}})
    assert left_out == []
    path = tmp_path / "out.x3d"
    path.write_text(text)
    tables = read_x3d(path).tables
    other = SerialRobot(name="r", **tables["robots"]["r"])
    assert other.dh_convention == "craig"
    worlds = [World(Scene(robots=[each])) for each in (robot, other)]
    for _ in range(5):
        q = rng.uniform(-3, 3, 5)
        assert np.allclose(robot.fwd_kin_base_to_flange(q), other.fwd_kin_base_to_flange(q))
        centres = []
        for world in worlds:
            data = world.make_data()
            world.set_input(data, "r.joint_angles", q)
            mujoco.mj_kinematics(world.model, data)
            centres.append(data.site_xpos[world.joints.centre_site])
        assert np.allclose(*centres)


@pytest.mark.parametrize(
    ("scene", "lost"),
    [
        ("slides.toml", ["robots.scara (prismatic joints)"]),
        ("lwr_contact", ["robots.lwr.torque_limits", "doubles", "arrows", "routes.force.vector"]),
        ("mirrored.toml", ["robots.left (mirrored)"]),
        ("tree.toml", ["robots.tree (no DH table)"]),
        ("expressions.toml", ["routes.lwr.joint_angles", "sources.fri (of kind 'fri')",
                              "objects.pill (capsule)", "robots.lwr.children.lamp (not on the"]),
    ],
)  # fmt: skip
def test_features_that_x3d_cannot_express_are_listed(
    scene: str, lost: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    box = '[objects.box]\nshape = "box"\nsize = [1, 1, 1]\n'
    files = {
        "slides.toml": f'{box}[robots.scara]\nmodel = "scara"\n',
        "mirrored.toml": f'{box}[robots.left]\nmodel = "puma560"\nmirrored = true\n',
        "tree.toml": f'{box}[robots.tree]\ndh_convention = "none"\n'
        "joint_frames = [{ xyz = [0, 0, 0.2] }, { xyz = [0.1, 0, 0] }]\n",
        "expressions.toml": """
[robots.lwr]
model = "lwr"
children = [{ name = "lamp", shape = "sphere", size = [0.1], on = "base" }]
[sources.udp]
kind = "udp"
structure = "7F"
[sources.fri]
kind = "fri"
[routes]
"lwr.joint_angles" = "udp.values0 * deg"
[objects.pill]
shape = "capsule"
size = [0.1, 0.2]
""",
    }
    path: Path | str = scene
    if scene in files:
        path = tmp_path / scene
        path.write_text(files[scene])
    convert(path, tmp_path / "out.x3d")
    err = " ".join(capsys.readouterr().err.split())
    assert err.startswith("sero-mj: X3D cannot express these parts of the scene: ")
    for each in lost:
        assert each in err
    load_scene(tmp_path / "out.x3d")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["fig7.x3d", "b.x3d"], "fig7.x3d and b.x3d: both files are X3D; expected one"),
        (["lwr_udp", "b.toml"], "lwr_udp and b.toml: both files are TOML"),
        (["lwr_udp", "b.toml", "--fps", "3"], "--fps is not available for toml files"),
        (["fig7.x3d", "there.toml"], "there.toml already exists; use --overwrite to replace it"),
        (["fig7.x3d", "no/b.toml"], "cannot write no/b.toml: No such file or directory"),
        (["scara", "b.x3d"], "scara: X3D cannot express any part of the scene: robots."),
        (["fig8.x3d", "b.toml"], "fig8.x3d: no such file; did you mean 'fig7.x3d'?"),
    ],
)  # fmt: skip
def test_scenes_that_cannot_be_converted_are_reported(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("fig7.x3d").write_bytes(FIG7.read_bytes())
    Path("there.toml").write_text("x = 1")
    with pytest.raises(SystemExit) as done:
        main(["export", *arguments])
    assert done.value.code == 2
    assert message in capsys.readouterr().err


_PLAIN = st.one_of(
    st.booleans(), st.integers(-(2**60), 2**60), st.floats(allow_nan=False), st.text(max_size=20)
)
_KEYS = st.text(min_size=1, max_size=8)
_VALUES = st.recursive(
    _PLAIN,
    lambda inner: st.one_of(st.lists(inner, max_size=5), st.dictionaries(_KEYS, inner, max_size=4)),
    max_leaves=25,
)


@given(tables=st.dictionaries(_KEYS, _VALUES, max_size=5))
def test_written_toml_is_read_unchanged(tables: dict[str, Any]) -> None:
    assert tomllib.loads(toml_text(tables, ["a comment"])) == tables


def test_toml_is_readable() -> None:
    tables = {
        "floor": True,
        "robots": {
            "arm": {
                "dh_params": [[0.0, 0.0, 0.0, 0.31], [1.5708, 0.0, 0.0, 0.0], [0.0] * 4] * 2,
                "base_frame": {"xyz": [0.0, 0.5, 0.0]},
                "children": [{"name": "tool", "size": [0.1]}],
            }
        },
        "routes": {"arm.joint_angles": "udp.values0"},
    }
    assert toml_text(tables, ["A scene."]).split("\n") == [
        "# A scene.", "", "floor = true", "",
        "[robots.arm]",
        "dh_params = [", *["  [0.0, 0.0, 0.0, 0.31],", "  [1.5708, 0.0, 0.0, 0.0],",
                           "  [0.0, 0.0, 0.0, 0.0],"] * 2, "]",
        "base_frame = { xyz = [0.0, 0.5, 0.0] }", "",
        "[[robots.arm.children]]", 'name = "tool"', "size = [0.1]", "",
        "[routes]", '"arm.joint_angles" = "udp.values0"', "",
    ]  # fmt: skip
