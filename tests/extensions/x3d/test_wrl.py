"""Geometry of VRML97: closed forms, concave polygons, creases, colors, transforms, files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sero_mj.base.errors import DeclarationError
from sero_mj.base.frames import Array
from sero_mj.extensions.x3d.wrl import read_wrl
from sero_mj.extensions.x3d.wrl_geometry import Triangles, clip_ears

# An L, whose outline is concave, of height 1; and a notched one with a hole, joined by a bridge.
L_SHAPE = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]


def read(text: str, folder: Path) -> list[Triangles]:
    path = folder / "a.wrl"
    path.write_text(f"#VRML V2.0 utf8\n{text}", encoding="utf-8")
    return read_wrl(path)


def volume(pieces: list[Triangles]) -> float:
    """Returns the volume by the divergence theorem; faces must be closed and point outward."""
    total = 0.0
    for vertices, faces, _ in pieces:
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        total += float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0
    return total


def is_closed(pieces: list[Triangles]) -> bool:
    """Returns whether each edge occurs once in each direction, comparing vertex positions."""
    points = np.concatenate([vertices[faces] for vertices, faces, _ in pieces]).round(9)
    _, names = np.unique(points.reshape(-1, 3), axis=0, return_inverse=True)
    corners = names.reshape(-1, 3)
    edges = [tuple(edge) for edge in corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()]
    return len(set(edges)) == len(edges) and {(b, a) for a, b in edges} == set(edges)


def prism(outline: list[tuple[float, float]], more: str = "") -> str:
    n = len(outline)
    points = ", ".join(f"{x} {y} {z}" for z in (0, 1) for x, y in outline)
    below = " ".join(map(str, reversed(range(n))))
    above = " ".join(str(n + k) for k in range(n))
    sides = " ".join(f"{k} {(k + 1) % n} {n + (k + 1) % n} {n + k} -1" for k in range(n))
    return (
        f"Shape {{ geometry IndexedFaceSet {{ convex FALSE {more} coord Coordinate {{ point "
        f"[{points}] }} coordIndex [{below} -1, {above} -1, {sides}] }} }}"
    )


@pytest.mark.parametrize(
    ("text", "expected", "within"),
    [
        ("Box {}", 8.0, 1e-12),
        ("Box { size 1 2 3 }", 6.0, 1e-12),
        ("Sphere { radius 0.5 }", 4 / 3 * np.pi / 8, 0.02),
        ("Cylinder { radius 0.5 height 3 }", np.pi * 0.25 * 3, 0.01),
        ("Cone { bottomRadius 2 height 3 }", np.pi * 4, 0.01),
    ],
)
def test_primitives_are_closed_and_have_their_volume(
    text: str, expected: float, within: float, tmp_path: Path
) -> None:
    pieces = read(f"Shape {{ geometry {text} }}", tmp_path)
    assert is_closed(pieces)
    assert 0 <= expected - volume(pieces) + 1e-12 <= within * expected + 1e-11
    assert pieces[0][2] is None


def test_sizes_are_those_of_vrml97(tmp_path: Path) -> None:
    for text, half in [("Cylinder { radius 1 height 4 }", [1, 2, 1]), ("Cone {}", [1, 1, 1])]:
        ((vertices, _, _),) = read(f"Shape {{ geometry {text} }}", tmp_path)
        assert np.allclose([vertices.min(axis=0), vertices.max(axis=0)], [np.negative(half), half])
    ((vertices, _, _),) = read("Shape { geometry Cone {} }", tmp_path)
    top = vertices[vertices[:, 1] > 0.9]
    assert np.allclose(top[:, [0, 2]], 0.0)  # the apex is above, on y
    ((_, fewer, _),) = read("Shape { geometry Cylinder { top FALSE } }", tmp_path)
    ((_, all_of_it, _),) = read("Shape { geometry Cylinder {} }", tmp_path)
    assert len(fewer) == len(all_of_it) - 32


def test_concave_polygons_are_triangulated_correctly(tmp_path: Path) -> None:
    pieces = read(prism(L_SHAPE), tmp_path)
    assert is_closed(pieces) and volume(pieces) == pytest.approx(3.0)
    # Also if the file claims that they are convex, as many do.
    assert volume(read(prism(L_SHAPE).replace("convex FALSE", ""), tmp_path)) == pytest.approx(3.0)
    # A square with a square hole, with a bridge from the outer to the inner outline.
    outer = [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0)]
    inner = [(1, 1), (1, 3), (3, 3), (3, 1), (1, 1)]
    assert volume(read(prism([*outer, *inner]), tmp_path)) == pytest.approx(12.0)
    # Four corners, one of which is concave.
    dart = [(0.0, 0.0), (2.0, -1.0), (0.5, 0.0), (2.0, 1.0)]
    pieces = read(prism(dart), tmp_path)
    assert is_closed(pieces) and volume(pieces) == pytest.approx(0.5)


@given(
    radii=st.lists(st.floats(0.2, 3.0), min_size=4, max_size=40),
    normal=st.sampled_from([(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0), (0.6, 0, 0.8)]),
)
@settings(max_examples=60, deadline=None)
def test_ears_cover_a_star_shaped_polygon_once(radii: list[float], normal: tuple[float]) -> None:
    angles = np.arange(len(radii)) * 2 * np.pi / len(radii)
    flat = np.array(radii)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    z = np.array(normal, dtype=np.float64)
    x = np.array([0.8, 0.0, -0.6]) if abs(z[0]) == 0.6 else np.roll(np.abs(z), 1)
    axes = np.column_stack([x, np.cross(z, x)])
    outline = flat @ axes.T + [5.0, -3.0, 2.0]
    area = _area(outline)
    triangles = outline[clip_ears(outline, area)]
    areas = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) / 2
    assert np.allclose(areas.sum(axis=0), area)
    # None is flipped, so together they cover it once.
    assert (areas @ z >= -1e-9).all()
    assert np.linalg.norm(areas, axis=1).sum() == pytest.approx(np.linalg.norm(area))


def _area(outline: Array) -> Array:
    """Returns Newell's vector: along the normal, with the length of the area."""
    return np.asarray(np.cross(outline, np.roll(outline, -1, axis=0)).sum(axis=0) / 2)


def test_transforms_are_composed_as_in_vrml97(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    t, c, s = rng.normal(size=3), rng.normal(size=3), rng.uniform(0.5, 2.0, 3)
    axis, other = rng.normal(size=3), rng.normal(size=3)
    texts = [" ".join(f"{value:.12f}" for value in each) for each in (t, c, s, axis, other)]
    text = (
        f"Transform {{ translation {texts[0]} center {texts[1]} scale {texts[2]} "
        f"rotation {texts[3]} 0.7 scaleOrientation {texts[4]} -1.1 "
        "children Shape { geometry Box { size 2 2 2 } } }"
    )
    ((vertices, _, _),) = read(text, tmp_path)
    # P' = T C R SR S -SR -C P (ISO/IEC 14772-1, 6.52), with rotations by Rodrigues' formula.
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    expected = [
        t + c + _turn(axis, 0.7, _turn(other, -1.1, s * _turn(other, 1.1, p - c))) for p in corners
    ]
    for point in expected:
        assert np.linalg.norm(vertices - point, axis=1).min() < 1e-9


def _turn(axis: Array, angle: float, p: Array) -> Array:
    k = axis / np.linalg.norm(axis)
    turned = p * np.cos(angle) + np.cross(k, p) * np.sin(angle) + k * (k @ p) * (1 - np.cos(angle))
    return np.asarray(turned)


def test_mirrored_or_clockwise_faces_point_outward(tmp_path: Path) -> None:
    box = "Shape { geometry Box { size 1 1 1 } }"
    mirrored = read(f"Transform {{ scale -1 2 1 children {box} }}", tmp_path)
    assert volume(mirrored) == pytest.approx(2.0)
    outline = [*reversed(L_SHAPE)]
    assert volume(read(prism(outline, "ccw FALSE"), tmp_path)) == pytest.approx(3.0)
    assert volume(read(prism(outline), tmp_path)) == pytest.approx(-3.0)
    matrix = "1 0 0 0  0 1 0 0  0 0 1 0  5 6 7 1"  # X3D: the translation is the fourth row
    ((vertices, _, _),) = read(f"MatrixTransform {{ matrix {matrix} children {box} }}", tmp_path)
    assert np.allclose(vertices.mean(axis=0), [5, 6, 7])


@pytest.mark.parametrize(("crease", "count"), [(0.0, 36), (1.0, 36), (1.1, 24), (3.2, 12)])
def test_edges_are_sharp_above_the_crease_angle(crease: float, count: int, tmp_path: Path) -> None:
    # Six sides, 60 degrees (1.047 rad) apart, and 90 degrees to both ends. From 1.1 rad on, the
    # sides have their own two rings; above a half turn, nothing is sharp.
    angles = np.arange(6) * np.pi / 3
    outline = [(float(np.cos(a)), float(np.sin(a))) for a in angles]
    ((vertices, faces, _),) = read(prism(outline, f"creaseAngle {crease}"), tmp_path)
    assert len(vertices) == count
    assert len(faces) == 2 * 4 + 12


def test_colors_are_those_of_materials_and_faces(tmp_path: Path) -> None:
    red = (
        "appearance Appearance { material DEF M Material { diffuseColor 1 0 0 transparency .25 } }"
    )
    text = f"""
        Shape {{ {red} geometry Box {{}} }}
        Shape {{ appearance Appearance {{ material USE M }} geometry Sphere {{}} }}
        Shape {{ appearance Appearance {{ material Material {{}} }} geometry Cone {{}} }}
        Shape {{ geometry Cylinder {{}} }}
    """
    pieces = read(text, tmp_path)
    colors = [None if rgba is None else rgba.tolist() for _, _, rgba in pieces]
    assert colors == [[1, 0, 0, 0.75], [0.8, 0.8, 0.8, 1], None]
    square = (
        "coord Coordinate { point [0 0 0, 1 0 0, 1 1 0, 0 1 0] } coordIndex [0 1 2 -1 0 2 3 -1]"
    )
    by_face = (
        f"Shape {{ geometry IndexedFaceSet {{ {square} colorPerVertex FALSE "
        "color Color { color [0 1 0, 0 0 1] } colorIndex [1 0] } }"
    )
    pieces = read(by_face, tmp_path)
    found = {tuple(rgba[:3]): len(faces) for _, faces, rgba in pieces if rgba is not None}
    assert found == {(0, 0, 1): 1, (0, 1, 0): 1}
    by_vertex = by_face.replace("colorPerVertex FALSE", "").replace("[1 0]", "[0 0 0 -1 1 1 1 -1]")
    pieces = read(by_vertex, tmp_path)
    found = {tuple(rgba[:3]): len(faces) for _, faces, rgba in pieces if rgba is not None}
    assert found == {(0, 0, 1): 1, (0, 1, 0): 1}


def test_open_surfaces_can_be_two_sided(tmp_path: Path) -> None:
    square = "coord Coordinate { point [0 0 0, 1 0 0, 1 1 0, 0 1 0] } coordIndex [0 1 2 3]"
    for more, triangles in [("", 2), ("solid FALSE", 4)]:
        text = f"Shape {{ geometry IndexedFaceSet {{ {square} {more} }} }}"
        ((_, faces, _),) = read(text, tmp_path)
        assert len(faces) == triangles
    assert volume(read(prism(L_SHAPE, "solid FALSE"), tmp_path)) == pytest.approx(3.0)


def test_shapes_in_groups_protos_switches_and_inlines_are_read(tmp_path: Path) -> None:
    (tmp_path / "part.wrl").write_text("#VRML V2.0 utf8\nShape { geometry Box { size 1 1 1 } }")
    text = """
        PROTO Bar [ field SFVec3f size 1 1 1 ] { Shape { geometry Box { size IS size } } }
        Group { children [ Bar { size 1 1 2 } Bar {} ] }
        Switch { whichChoice 1 choice [ Shape { geometry Sphere {} } Bar { size 4 1 1 } ] }
        Switch { choice Bar { size 100 1 1 } }
        LOD { level [ Bar { size 8 1 1 } Bar { size 100 1 1 } ] }
        Transform { scale 2 2 2 children Inline { url "part.wrl" } }
        DEF once Shape { geometry IndexedTriangleSet { index [0 1 2, 0 2 1]
          coord Coordinate { point [0 0 0, 1 0 0, 0 1 0] } } }
        Collision { children USE once }
    """
    assert volume(read(text, tmp_path)) == pytest.approx(2 + 1 + 4 + 8 + 8)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Shape { geometry Box { size 1 0 1 } }",
         ":2: Box: size: found [0.5, 0, 0.5]; expected numbers above 0"),
        ("Shape {\n geometry DEF part IndexedFaceSet { coord Coordinate { point [0 0 0] }\n"
         "coordIndex [0 1 2 -1] } }", ":3: part: coordIndex: found 2; expected 0 to 0"),
        ("Shape { geometry IndexedFaceSet { coordIndex [0 1 2] } }",
         ":2: IndexedFaceSet: coordIndex: found 2; expected no index, because there are no points"),
        ("Shape { geometry IndexedFaceSet { coord Coordinate { point [0 0] } } }",
         ":2: Coordinate.point: found 2 numbers; expected 3 for each entry"),
        ("Inline { url 5 }",
         ":2: Inline.url: found 5; expected quoted strings, \"...\""),
        ("Transform { rotation 0 0 0 1 children Shape { geometry Box {} } }",
         ":2: Transform: found a rotation about 0 0 0 by 1; expected an axis"),
        ("Shape { appearance Appearance { material Material { diffuseColor 1 1 } } "
         "geometry Box {} }",
         ":2: Material.diffuseColor: found 2 numbers; expected 3 numbers"),
    ],
)  # fmt: skip
def test_errors_are_reported_with_lines(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(DeclarationError) as caught:
        read(text, tmp_path)
    assert str(caught.value) == f"{tmp_path / 'a.wrl'}{message}"


def test_self_inclusion_ends_and_unknown_nodes_are_listed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    text = 'Inline { url "a.wrl" }\nShape { geometry Text { string "x" } }\nPointSet {}\nBox {}\n'
    text += 'Inline { url ["../b.wrl" "http://x.org/b.wrl"] }'
    assert read(text, tmp_path) == []
    assert (
        "not drawn: Text (line 3), PointSet (line 4), Box (line 5), Inline of '../b.wrl', "
        "'http://x.org/b.wrl' (line 6)"
    ) in caplog.text
