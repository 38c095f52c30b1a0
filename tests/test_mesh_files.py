"""Mesh files of any format as pieces that MuJoCo compiles, and finding files that robots name."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from sero_mj.base.errors import DeclarationError
from sero_mj.base.frames import Array
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.dynamics import Dynamics
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.robots.importers import mesh_files
from sero_mj.robots.importers.mesh_files import MeshPiece, read_mesh
from sero_mj.robots.importers.package_files import find_file, package_of
from sero_mj.robots.importers.urdf import read_urdf

BOX = trimesh.creation.box((1.0, 2.0, 3.0))


def compiled(piece: MeshPiece, scale: float = 1.0) -> Array:
    """Returns the vertices (k, 3) that MuJoCo compiles from a piece."""
    spec = mujoco.MjSpec()
    spec.assets[f"piece{piece.ending}"] = piece.contents
    shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    spec.add_mesh(name="piece", file=f"piece{piece.ending}", inertia=shell, scale=[scale] * 3)
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH, meshname="piece", contype=0, conaffinity=0
    )
    model = spec.compile()
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.mesh_quat[0])
    return np.asarray(model.mesh_vert @ turn.reshape(3, 3).T + model.mesh_pos[0])


def refused(path: Path) -> str:
    with pytest.raises(DeclarationError) as caught:
        read_mesh(path)
    return str(caught.value).replace(f"{path.parent}{os.sep}", "")


@pytest.mark.parametrize("ending", ["stl", "obj", "ply", "off", "glb", "dae"])
def test_box_is_read_in_every_format(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"box.{ending.upper()}"
    trimesh.Scene([BOX]).export(path, file_type=ending) if ending == "glb" else BOX.export(
        path, file_type=ending
    )
    (piece,) = read_mesh(path)
    corners = compiled(piece)
    assert np.allclose(corners.min(axis=0), [-0.5, -1, -1.5], atol=1e-6)
    assert np.allclose(corners.max(axis=0), [0.5, 1, 1.5], atol=1e-6)
    if ending == "stl":
        assert piece.contents == path.read_bytes()


@pytest.mark.slow
def test_ascii_stl_and_stl_with_too_many_faces_are_converted(tmp_path: Path) -> None:
    path = tmp_path / "ascii.stl"
    path.write_text(trimesh.exchange.stl.export_stl_ascii(BOX), encoding="ascii")
    (piece,) = read_mesh(path)
    assert piece.ending == ".msh" and np.ptp(compiled(piece), axis=0) == pytest.approx([1, 2, 3])
    path = tmp_path / "fine.stl"
    facets = np.zeros(200_001, mesh_files._FACET)  # MuJoCo accepts 200,000
    facets["corners"] = np.tile(BOX.triangles, (20_000, 1, 1))[: len(facets)]
    path.write_bytes(bytes(80) + struct.pack("<I", len(facets)) + facets.tobytes())
    (piece,) = read_mesh(path)
    assert np.ptp(compiled(piece), axis=0) == pytest.approx([1, 2, 3])


COLLADA = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="millimetre" meter="0.001"/><up_axis>Y_UP</up_axis></asset>
<library_images><image id="i"><init_from>{picture}</init_from></image></library_images>
<library_effects>
<effect id="red-fx"><profile_COMMON><technique sid="c"><lambert><diffuse>
<color>0.8 0.1 0.2 1</color></diffuse></lambert></technique></profile_COMMON></effect>
<effect id="pic-fx"><profile_COMMON><newparam sid="s"><surface type="2D"><init_from>i</init_from>
</surface></newparam><newparam sid="p"><sampler2D><source>s</source></sampler2D></newparam>
<technique sid="c"><lambert><diffuse><texture texture="p" texcoord="UV"/></diffuse></lambert>
</technique></profile_COMMON></effect></library_effects>
<library_materials><material id="red"><instance_effect url="#red-fx"/></material>
<material id="pic"><instance_effect url="#pic-fx"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="12">0 0 0 100 0 0 0 200 0 0 0 300</float_array>
<technique_common><accessor source="#pa" count="4" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles material="m" count="4"><input semantic="VERTEX" source="#v" offset="0"/>
<p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s">
<node><translate>1000 0 0</translate><rotate>0 0 1 90</rotate><scale>1 -1 1</scale>
<instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="m" target="#red"/></technique_common></bind_material></instance_geometry>
</node><node><instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="m" target="#{second}"/></technique_common></bind_material>
</instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>
"""


def test_collada_units_nodes_and_colors_are_read(tmp_path: Path) -> None:
    Image.new("RGB", (4, 4), (255, 128, 0)).save(tmp_path / "orange.png")
    path = tmp_path / "two.dae"
    path.write_text(COLLADA.format(picture="orange.png", second="pic"), encoding="utf-8")
    red, orange = read_mesh(path)
    assert red.rgba == (0.8, 0.1, 0.2, 1.0)
    assert orange.rgba == pytest.approx((1.0, 128 / 255, 0.0, 1.0), abs=1e-4)
    # Millimeters; the file's own axes, regardless of its up axis; mirrored at y, rotated about z.
    assert np.allclose(np.ptp(compiled(orange), axis=0), [0.1, 0.2, 0.3])
    corners = compiled(red)
    assert np.allclose(corners.min(axis=0), [1.0, 0.0, 0.0], atol=1e-6)
    assert np.allclose(corners.max(axis=0), [1.2, 0.1, 0.3], atol=1e-6)


@pytest.mark.parametrize(
    ("transparency", "alpha", "warning"),
    [
        ("", 1.0, ""),
        ('<transparent opaque="A_ONE"><color>1 1 1 1</color></transparent>', 1.0, ""),
        ('<transparent opaque="A_ONE"><color>1 1 1 0.3</color></transparent>', 0.3, "opacity 0.3"),
        ('<transparent opaque="RGB_ZERO"><color>.8 .8 .8 1</color></transparent>'
         "<transparency><float>0.5</float></transparency>", 0.6, "opacity 0.6"),
        ('<transparent opaque="A_ZERO"><color>1 1 1 0.3</color></transparent>', 0.7, "opacity 0.7"),
        ("<transparency><float>0.4</float></transparency>", 0.4, "opacity 0.4"),
        # Some exporters write this for opaque.
        ("<transparency><float>0</float></transparency>", 1.0, "'red' would be invisible"),
    ],
)  # fmt: skip
def test_collada_transparency_follows_the_specification(
    tmp_path: Path, caplog, transparency: str, alpha: float, warning: str
) -> None:
    path = tmp_path / "two.dae"
    text = COLLADA.format(picture="none.png", second="red")
    text = text.replace("</diffuse></lambert>", f"</diffuse>{transparency}</lambert>", 1)
    path.write_text(text, encoding="utf-8")
    (red,) = read_mesh(path)
    assert red.rgba == (0.8, 0.1, 0.2, alpha)
    assert warning in caplog.text and bool(warning) == bool(caplog.records)


TWO_SIDES = (
    "mtllib {file}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    "usemtl dark red\nf 1 3 2\nf 1 2 4\nusemtl light  blue\nf 1 4 3\nf 2 3 4\n"
)


@pytest.mark.parametrize(
    ("material", "alpha"),
    [("d 0.3", 0.3), ("Tr 0.7", 0.3), ("d -halo 0.3", 0.3), ("d 0.3\nTr 0.3", 0.3), ("d 1", 1.0),
     ("", 1.0), ("d 0", 1.0), ("d nan", 1.0), ("d x", 1.0)],
)  # fmt: skip
@pytest.mark.parametrize("is_one", [False, True])  # one colour: the file is passed on
def test_transparency_of_obj_materials_is_read(
    tmp_path: Path, material: str, alpha: float, is_one: bool
) -> None:
    blue = f"newmtl light  blue\nKd 0.1 0.2 0.8\n{material}\n"
    (tmp_path / "m.mtl").write_text(f"newmtl dark red\nKd 0.8 0.1 0.1\n\n{blue}")
    text = TWO_SIDES.format(file="m.mtl")
    text = text.replace("usemtl dark red\n", "") if is_one else text
    (tmp_path / "a.obj").write_text(text)
    pieces = read_mesh(tmp_path / "a.obj")
    assert [piece.rgba for piece in pieces if piece.rgba[0] < 0.5] == [(0.1, 0.2, 0.8, alpha)]
    assert len(pieces) == 2 - is_one


@pytest.mark.parametrize(
    ("file", "named", "encoding", "end"),
    [
        ("m.mtl", "M.MTL", "utf-8", "\n"),
        ("my part.mtl", "my part.mtl", "utf-8-sig", "\n"),
        ("m.mtl", "none.mtl   m.mtl", "utf-8", "\r\n"),
        ("m.mtl", ".\\m.mtl", "utf-16", "\n"),
    ],
)
def test_obj_materials_are_found_in_any_notation(
    tmp_path: Path, file: str, named: str, encoding: str, end: str
) -> None:
    text = "\tnewmtl\tdark  red \n\tKd 0.8 0.1 0.1\n\nNEWMTL light blue\nkd 0.1 0.2 0.8\n"
    (tmp_path / file).write_text(text.replace("\n", end), encoding=encoding, newline="")
    obj = TWO_SIDES.format(file=named).replace("\n", end)
    (tmp_path / "a.obj").write_text(obj, encoding="utf-8-sig", newline="")
    found = {piece.rgba for piece in read_mesh(tmp_path / "a.obj")}
    assert found == {(0.8, 0.1, 0.1, 1.0), (0.1, 0.2, 0.8, 1.0)}


@pytest.mark.parametrize(
    ("mode", "factor", "alpha"),
    [("OPAQUE", 80, 1.0), ("BLEND", 80, 80 / 255), ("MASK", 140, 1.0), ("MASK", 80, 0.0)],
)
def test_gltf_transparency_follows_its_mode(
    tmp_path: Path, mode: str, factor: int, alpha: float
) -> None:
    look = trimesh.visual.material.PBRMaterial(baseColorFactor=[25, 50, 200, factor],
                                               alphaMode=mode)  # fmt: skip
    box = trimesh.Trimesh(BOX.vertices, BOX.faces, visual=trimesh.visual.TextureVisuals(None, look))
    box.export(tmp_path / "a.glb")
    (piece,) = read_mesh(tmp_path / "a.glb")
    assert piece.rgba == pytest.approx((25 / 255, 50 / 255, 200 / 255, alpha), abs=1e-3)


def test_vertex_alpha_is_preserved(tmp_path: Path) -> None:
    box = trimesh.Trimesh(BOX.vertices, BOX.faces, vertex_colors=[[25, 50, 200, 80]] * 8)
    box.export(tmp_path / "a.ply")
    (piece,) = read_mesh(tmp_path / "a.ply")
    assert piece.rgba == pytest.approx((0.098, 0.1961, 0.7843, 0.3137))


@pytest.mark.parametrize(("has_own", "expected"), [(True, 0.4 * 80 / 255), (False, 0.4)])
def test_urdf_material_opacity_applies_to_meshes(
    tmp_path: Path, has_own: bool, expected: float
) -> None:
    colors = [[25, 50, 200, 80]] * 8 if has_own else None
    trimesh.Trimesh(BOX.vertices, BOX.faces, vertex_colors=colors).export(tmp_path / "a.ply")
    (tmp_path / "r.urdf").write_text(
        '<robot name="r"><link name="a"/><link name="b"><visual><geometry><mesh filename="a.ply"/>'
        '</geometry><material name="m"><color rgba="1 0 0 0.4"/></material></visual></link>'
        '<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint></robot>'
    )
    model = World(Scene(robots=[SerialRobot.from_urdf(tmp_path / "r.urdf")], floor=False)).model
    red, _, blue, alpha = model.geom_rgba[-1]
    assert alpha == pytest.approx(expected, abs=1e-4)
    assert (blue > red) == has_own


def faces_of(piece: MeshPiece) -> Array:
    """Returns corners (f, 3, 3) of a piece in MuJoCo's own format."""
    counts = struct.unpack("<4i", piece.contents[:16])
    vertices = np.frombuffer(piece.contents, "<f4", 3 * counts[0], 16).reshape(-1, 3)
    faces = np.frombuffer(
        piece.contents, "<i4", 3 * counts[3], len(piece.contents) - 12 * counts[3]
    )
    return vertices[faces.reshape(-1, 3)].astype(np.float64)


def test_mirrored_nodes_have_outward_faces(tmp_path: Path) -> None:
    path = tmp_path / "two.dae"
    path.write_text(COLLADA.format(picture="none.png", second="red"), encoding="utf-8")
    (both,) = read_mesh(path)  # one color: one piece
    a, b, c = np.moveaxis(faces_of(both), 1, 0)
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    assert volume.sum() == pytest.approx(2 * 0.1 * 0.2 * 0.3 / 6)


def test_unreadable_material_loses_only_the_color(tmp_path: Path) -> None:
    path = tmp_path / "two.dae"
    text = COLLADA.format(picture="none.png", second="pic").replace(
        '<image id="i">', '<image id="j">'
    )
    path.write_text(text, encoding="utf-8")
    pieces = read_mesh(path)
    assert [piece.rgba for piece in pieces] == [(0.8, 0.1, 0.2, 1.0), None]


@pytest.mark.extensions
def test_vrml_material_colors_are_read(tmp_path: Path) -> None:
    path = tmp_path / "two.wrl"
    path.write_text(
        "#VRML V2.0 utf8\nTransform { translation 1 0 0 children Shape {\n"
        "geometry Box { size 1 2 3 }\n"
        "appearance Appearance { material Material { diffuseColor 1 0 0 transparency 0.5 } } } }\n"
        "Shape { geometry Sphere { radius 0.5 } }",
        encoding="utf-8",
    )
    box, sphere = read_mesh(path)
    assert (box.rgba, sphere.rgba) == ((1.0, 0.0, 0.0, 0.5), None)
    corners = compiled(box)
    assert np.allclose([corners.min(axis=0), corners.max(axis=0)], [[0.5, -1, -1.5], [1.5, 1, 1.5]])
    path.write_text("#VRML V2.0 utf8\nTransform {", encoding="utf-8")
    assert refused(path) == "two.wrl:2: the { of Transform is not closed"


def test_obj_material_colors_are_read(tmp_path: Path) -> None:
    (tmp_path / "m.mtl").write_text("newmtl a\nKd 1 0 0\nnewmtl b\nKd 0 0 1\n", encoding="utf-8")
    points = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    path = tmp_path / "one.obj"
    path.write_text(f"mtllib m.mtl\n{points}usemtl b\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    (piece,) = read_mesh(path)
    assert piece.rgba == (0, 0, 1, 1) and piece.contents.strip() == path.read_bytes().strip()
    both = points + points.replace("v 0", "v 5")
    faces = "usemtl a\nf 1 3 2\nf 1 2 4\nf 1 4 3\nusemtl b\nf 5 7 6\nf 5 6 8\nf 5 8 7\nf 6 7 8\n"
    path = tmp_path / "two.obj"
    path.write_text(f"mtllib m.mtl\n{both}{faces}")
    assert sorted(piece.rgba or () for piece in read_mesh(path)) == [(0, 0, 1, 1), (1, 0, 0, 1)]


TETRAHEDRON = np.array([[1, 3, 2], [1, 2, 4], [1, 4, 3], [2, 3, 4]])
FORMS = {"v": "{0}", "v/t": "{0}/9", "v//n": "{0}//9", "v/t/n": "{0}/9/9"}


@pytest.mark.parametrize("last", [0, 1])
@pytest.mark.parametrize("forms", [*FORMS, "v v/t/n", "v//n v/t", "v/t v v/t/n v//n"])
def test_obj_face_corners_are_read_in_any_form(tmp_path: Path, forms: str, last: int) -> None:
    texts = [FORMS[form] for form in forms.split()]
    points = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    corners = TETRAHEDRON.flatten()
    corners[-1] += last
    words = [texts[i % len(texts)].format(corner) for i, corner in enumerate(corners)]
    faces = "\n".join("f " + " ".join(words[i : i + 3]) for i in range(0, 12, 3))
    path = tmp_path / "forms.obj"
    path.write_text(points + "vt 0 0\n" * 9 + "vn 0 0 1\n" * 9 + faces, encoding="utf-8")
    if last and " " not in forms:
        assert refused(path) == "mesh forms.obj has faces with nonexistent vertices"
    elif not last:
        assert read_mesh(path)[0].points.shape == (4, 3)


@pytest.mark.parametrize(
    ("name", "contents", "expected"),
    [
        ("a.mesh", b"", "mesh a.mesh: found '.mesh'; expected .stl, .obj, .msh, .dae"),
        ("no.stl", None, "mesh no.stl: No such file or directory"),
        ("empty.stl", b"", "mesh empty.stl has "),
        ("cut.stl", bytes(80) + struct.pack("<I", 9) + bytes(60), "mesh cut.stl is "),
        ("nan.stl", bytes(80) + struct.pack("<I12fH", 1, *[np.nan] * 12, 0),
         "mesh nan.stl has vertices that are not finite numbers"),
        ("point.stl", bytes(80) + struct.pack("<I", 1) + bytes(50),
         "mesh point.stl has fewer than 4 distinct vertices"),
        ("text.obj", b"v 0 0 0\nv 1 x 0\nv 0 1 0\nf 1 2 3\n",
         "mesh text.obj has a vertex that is not three numbers"),
        ("none.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n", "mesh none.obj has "),
        ("odd.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 5\n",
         "mesh odd.obj has faces with nonexistent vertices"),
        ("odd.msh", struct.pack("<4i", 4, 0, 0, 1) + np.eye(4, 3, dtype="<f4").tobytes()
         + struct.pack("<3i", 0, 1, 4), "mesh odd.msh has faces with nonexistent vertices"),
        ("short.msh", b"123", "mesh short.msh does not have the size"),
        ("bad.dae", b"<COLLADA", "mesh bad.dae cannot be read: "),
        ("other.dae", b"<robot/>", "mesh other.dae "),
        ("bad.ply", b"ply\nformat", "mesh bad.ply cannot be read: "),
        ("bad.glb", b"glTF\2\0\0\0\1\0\0\0", "mesh bad.glb cannot be read: "),
    ],
)  # fmt: skip
def test_invalid_meshes_are_rejected(
    tmp_path: Path, name: str, contents: bytes | None, expected: str
) -> None:
    if contents is not None:
        (tmp_path / name).write_bytes(contents)
    assert refused(tmp_path / name).startswith(expected)


def test_missing_mesh_is_reported_with_its_line(tmp_path: Path) -> None:
    """A robot without a scene file."""
    file = tmp_path / "crane" / "robot.toml"
    file.parent.mkdir()
    rows = "dh_params = [[0, 0, 0, 0.3]]"
    file.write_text(f'dh_convention = "craig"\n{rows}\n\nfilenames = ["a.obj", "b.obj"]\n')
    with pytest.raises(DeclarationError) as refused:
        World(load_scene(file.parent))
    told = [(each.file, each.line, each.key) for each in refused.value.problems]
    assert told == [(str(file), 4, "filenames.0"), (str(file), 4, "filenames.1")]


def corrupted(contents: bytes, data: st.DataObject) -> bytes:
    """Returns a file with a few bytes changed, added, or removed."""
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(contents) - 1))
        cut = data.draw(st.integers(0, 8))
        more = data.draw(st.one_of(st.binary(max_size=4), st.sampled_from([b"nan", b"1e999"])))
        contents = contents[:at] + more + contents[at + cut :]
        if not contents:
            break
    return contents


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["stl", "obj", "ply", "glb", "dae", "wrl"])
@given(data=st.data())
def test_damaged_files_raise_only_declaration_errors(
    tmp_path_factory: pytest.TempPathFactory, ending: str, data: st.DataObject
) -> None:
    path = tmp_path_factory.getbasetemp() / f"damaged.{ending}"
    if ending == "dae":
        path.write_text(COLLADA.format(picture="none.png", second="pic"), encoding="utf-8")
    elif ending == "wrl":
        path.write_text("#VRML V2.0 utf8\nShape { geometry Box { size 1 2 3 } }", encoding="utf-8")
    else:
        trimesh.Scene([BOX]).export(path) if ending == "glb" else BOX.export(path)
    path.write_bytes(corrupted(path.read_bytes(), data))
    try:
        pieces = read_mesh(path)
    except DeclarationError as error:
        assert str(error)
    else:
        assert all(len(piece.points) >= 3 for piece in pieces)


def test_too_large_files_are_rejected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mesh_files, "MAX_MESH_BYTES", 100)
    monkeypatch.setattr(mesh_files, "MAX_CONVERTED_BYTES", 50)
    for name, size, most in (("a.stl", 200, "0.0001"), ("a.dae", 80, "5e-05")):
        (tmp_path / name).write_bytes(bytes(size))
        found = refused(tmp_path / name)
        assert f"expected at most {most} MB" in found
    (tmp_path / "b.stl").write_bytes(b"solid" + bytes(80))
    assert "of STL that MuJoCo cannot read without conversion" in refused(tmp_path / "b.stl")


def test_meshes_are_cached_until_the_file_changes(tmp_path: Path) -> None:
    path = tmp_path / "box.ply"
    BOX.export(path)
    first = read_mesh(path)
    assert read_mesh(path)[0] is first[0]
    trimesh.creation.box((2, 2, 2)).export(path)
    assert np.ptp(compiled(read_mesh(path)[0]), axis=0) == pytest.approx([2, 2, 2])


@pytest.mark.parametrize("head", [b"", b"solid made by "])
def test_truncated_stl_reports_how_many_triangles_it_has(tmp_path: Path, head: bytes) -> None:
    path = tmp_path / "box.stl"
    BOX.export(path)
    whole = path.read_bytes()
    path.write_bytes(head + whole[len(head) : 84 + 3 * 50 + 20])
    assert "box.stl is truncated: found 3 of 12 triangles" in refused(path)


def test_only_geoms_with_mass_or_contacts_get_a_hull(tmp_path: Path) -> None:
    BOX.export(tmp_path / "box.stl")
    robot = SerialRobot(
        dh_convention="craig",
        dh_params=[[0, 0, 0, 0.1]] * 2,
        filenames=["box.stl"] * 3,
        directory=str(tmp_path),
        dynamics={"masses": [3, 2, 1], "centers_of_mass": np.eye(3), "inertias": [np.eye(3)] * 3},
    )
    seen = World(Scene(robots=[robot])).model
    assert (seen.mesh_graphadr < 0).all()
    links = [seen.body(f"{robot.name}/link{i}") for i in (1, 2)]
    assert [float(link.mass[0]) for link in links] == [2, 1]
    assert [link.ipos.tolist() for link in links] == [[0, 1, 0], [0, 0, 1]]
    by_volume = World(Scene(robots=[robot.model_copy(update={"dynamics": Dynamics()})])).model
    assert (by_volume.mesh_graphadr >= 0).all()
    assert by_volume.body(f"{robot.name}/link1").mass == pytest.approx(1000 * BOX.volume)


@pytest.fixture
def package(tmp_path: Path) -> Path:
    folder = tmp_path / "ws" / "my_arm"
    (folder / "urdf").mkdir(parents=True)
    (folder / "meshes" / "in box").mkdir(parents=True)
    BOX.export(folder / "meshes" / "box.stl")
    BOX.export(folder / "meshes" / "in box" / "box.stl")
    return folder


@pytest.mark.parametrize(
    "name",
    [
        "package://my_arm/meshes/box.stl",
        "package://my_arm//meshes/box.stl",
        "package://other/meshes/box.stl",  # a copy with another name
        "model://my_arm/meshes/in%20box/box.stl",
        "../meshes/box.stl",
        "meshes/box.stl",
        "meshes\\box.stl",
        "package://my_arm/Meshes/BOX.STL",
        "../meshes/Box.stl",
        "file://$(find my_arm)/meshes/box.stl",
        "$(find-pkg-share my_arm)/meshes/box.stl",
    ],
)
def test_meshes_are_found_above_the_file(package: Path, name: str) -> None:
    found = find_file(name, package / "urdf" / "arm.urdf")
    assert found is not None and found.name == "box.stl" and package in found.parents


def test_case_matters_only_for_otherwise_equal_names(package: Path) -> None:
    meshes = package / "meshes"
    for name in ("BOX.stl", "bOX.stl"):
        (meshes / name).write_bytes((meshes / "box.stl").read_bytes())
    beside = package / "urdf" / "arm.urdf"
    for name in ("box.stl", "BOX.stl", "bOX.stl"):
        assert find_file(f"../meshes/{name}", beside) == meshes / name
    assert package_of("file://$(find odd)/meshes/box.stl") == "odd"


def test_packages_are_found_by_environment_and_option(
    package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    far = tmp_path / "elsewhere" / "arm.urdf"
    box = package / "meshes" / "box.stl"
    name = "package://my_arm/meshes/box.stl"
    for variable in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", "GZ_SIM_RESOURCE_PATH"):
        monkeypatch.delenv(variable, raising=False)
    assert find_file(name, far) is None
    assert find_file(f"file://{box}", far) == box
    assert find_file(name, far, {"my_arm": package}) == box
    for variable, folder in (
        ("ROS_PACKAGE_PATH", package.parent),
        ("ROS_PACKAGE_PATH", package),
        ("ROS_PACKAGE_PATH", tmp_path),  # a stack
        ("GZ_SIM_RESOURCE_PATH", package.parent),
    ):
        with monkeypatch.context() as patch:
            patch.setenv(variable, f"/nowhere{os.pathsep}{folder}")
            assert find_file(name, far) == box
    prefix = tmp_path / "prefix"
    (prefix / "share").mkdir(parents=True)
    (prefix / "share" / "my_arm").symlink_to(package)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(prefix))
    found = find_file(name, far)
    assert found is not None and found.samefile(box)
    assert find_file("package://my_arm/\0", far) is None


def test_missing_meshes_are_left_out_and_listed_once(package: Path) -> None:
    (package / "meshes" / "bad.dae").write_text("<COLLADA")
    visuals = "".join(
        f'<visual><geometry><mesh filename="{name}" scale="{scale}"/></geometry>\n'
        '<material name="m"><color rgba="1 0 0 1"/></material></visual>'
        for name, scale in (
            ("package://my_arm/meshes/box.stl", "0.001 0.001 0.001"),
            ("package://odd/meshes/no.stl", "1 1 1"),
            ("../meshes/none.dae", "1 1 1"),
            ("package://odd/meshes/no.stl", "1 1 1"),
            ("../meshes/bad.dae", "1 1 1"),
        )
    )
    path = package / "urdf" / "arm.urdf"
    path.write_text(
        f'<robot name="arm"><link name="a">{visuals}</link><link name="b"/><joint name="j" '
        'type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>'
    )
    read = read_urdf(path)
    assert read.tables["filenames"] == [[{"file": "box.stl", "scale": 0.001, "color": "m"}], []]
    assert Path(read.tables["directory"]) == package / "meshes"
    missing, unread, _ = read.warnings
    assert missing == (
        "2 mesh files were not found; set its folder with --package odd=DIR: "
        "package://odd/meshes/no.stl, ../meshes/none.dae"
    )
    assert unread.startswith(f"mesh {package}/meshes/bad.dae cannot be read: ")
