"""The classic VRML syntax: reading it, and its errors."""

from __future__ import annotations

import gzip
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, raises_with
from hypothesis import given, settings
from hypothesis import strategies as st

from sero_mj.base.errors import DeclarationError
from sero_mj.extensions.x3d.reader import read_x3d
from sero_mj.extensions.x3d.vrml import parse_document, read_document
from sero_mj.extensions.x3d.vrml_nodes import FieldValue, Node, instance, read_field
from sero_mj.extensions.x3d.wrl import read_wrl

FIG7 = ROOT / "tests" / "fig7.x3d"
HERE = Path("scene.x3d")
WHOLE = """\
#X3D V3.0 utf8
PROFILE Immersive COMPONENT Shape:2 META "title" "all of it" UNIT length mm 0.001
EXTERNPROTO SerialRobot [ field SFString name exposedField MFFloat jointAngles ] ["a.wrl", "b.wrl"]
PROTO Ball [ field SFFloat size 0.5  exposedField SFColor tone 1 0 0  eventIn SFBool on ] {
  Shape {
    appearance Appearance { material Material { diffuseColor IS tone } }
    geometry Sphere { radius IS size }
  }
}
Scene { children [
  DEF arm SerialRobot { dhParams [ 0 0 0 .31, 1.5 0 0 0 ] jointAngles 0.1, 0.2 name "arm" }
  Ball { size 2 } Ball {}
  DEF turn Transform { rotation 0 0 1 1.57 children Shape { geometry DEF box Box { size 1 2 3 } } }
  USE turn
  Script { field SFNode own USE turn eventOut SFFloat out url "javascript: # no comment \\"x\\"" }
  DEF udp UdpReceiver { structure "2F" udpport 32000 isDouble TRUE }
  Shape { geometry IndexedFaceSet { coord Coordinate { point [0 0 0, 1 0 0, 0 1 0] }
    coordIndex [0 1 2 -1] } }
]
ROUTE udp.values0 TO arm.jointAngles }
"""


def parse(text: str) -> Node:
    """Returns the first node of a text."""
    return parse_document(text, HERE).nodes[0]


def errors_in(text: str) -> list[str]:
    """Returns the errors of a text, one line each."""
    with pytest.raises(DeclarationError) as caught:
        parse_document(text, HERE)
    return str(caught.value).splitlines()


def nodes_of(node: Node) -> list[Node]:
    """Returns a node and its descendants, each once."""
    found = {id(node): node}
    for value in node.fields.values():
        for item in value.items:
            if isinstance(item, Node):
                found |= {id(each): each for each in nodes_of(item)}
    return [*found.values()]


def test_every_kind_of_statement_is_read() -> None:
    document = parse_document(WHOLE, HERE)
    assert set(document.names) == {"arm", "turn", "box", "udp"}
    assert set(document.protos) == {"SerialRobot", "Ball"}
    assert document.protos["SerialRobot"].urls == ("a.wrl", "b.wrl")
    ball = document.protos["Ball"].fields
    assert (ball["size"].access, ball["size"].type) == ("initializeOnly", "SFFloat")
    assert ball["on"].value is None
    (route,) = document.routes
    assert (route.origin, route.event, route.target, route.input) == (
        "udp", "values0", "arm", "jointAngles",
    )  # fmt: skip
    arm = document.names["arm"]
    assert arm.line == 11
    assert read_field(arm.fields["dhParams"], "MFVec4f").tolist() == [
        [0, 0, 0, 0.31], [1.5, 0, 0, 0],
    ]  # fmt: skip
    assert read_field(arm.fields["jointAngles"], "MFFloat").tolist() == [0.1, 0.2]
    used = [node for root in document.nodes for node in nodes_of(root) if node.kind == "Box"]
    assert used == [document.names["box"]]  # once, though it is used twice


def test_proto_makes_nodes_with_its_values_and_defaults() -> None:
    scene = parse_document(WHOLE, HERE).nodes[0]
    balls = [node for node in read_field(scene.fields["children"], "MFNode") if node.kind == "Ball"]
    made = [instance(ball) for ball in balls]
    radii, tones = [], []
    for shape in made:
        assert shape is not None
        (sphere,) = [node for node in nodes_of(shape) if node.kind == "Sphere"]
        (material,) = [node for node in nodes_of(shape) if node.kind == "Material"]
        radii.append(read_field(sphere.fields["radius"], "SFFloat"))
        tones.append(read_field(material.fields["diffuseColor"], "SFColor").tolist())
    assert radii == [2.0, 0.5]
    assert tones == [[1, 0, 0], [1, 0, 0]]


@pytest.mark.parametrize("sign", ["←", "↩", "\\", "¬", "⏎", ""])
def test_continuation_marks_of_papers_are_ignored(sign: str) -> None:
    node = parse(f'R {{ a [ 1 2, {sign}\n 3 4 ] b [ "x", {sign} \n "y" ] }}')
    assert read_field(node.fields["a"], "MFFloat").tolist() == [1, 2, 3, 4]
    assert read_field(node.fields["b"], "MFString") == ["x", "y"]


# For every type, a value in brackets, one without if possible, and the value read.
FIELDS = [
    ("SFBool", "TRUE", True),
    ("MFBool", "[TRUE, FALSE]", [True, False]),
    ("SFInt32", "0x1F", 31),
    ("MFInt32", "[1 -2,3]", [1, -2, 3]),
    ("SFFloat", "-1.5e-3", -0.0015),
    ("SFDouble", "[+.5]", 0.5),
    ("MFFloat", "1 2. 3", [1, 2, 3]),
    ("SFTime", "7", 7.0),
    ("SFString", r'"a \"quoted\" # word"', 'a "quoted" # word'),
    ("MFString", '["a" "b"]', ["a", "b"]),
    ("MFString", '"a"', ["a"]),
    ("SFVec2f", "1 2", [1, 2]),
    ("SFVec3f", "[1 2 3]", [1, 2, 3]),
    ("MFVec3d", "[1 2 3, 4 5 6]", [[1, 2, 3], [4, 5, 6]]),
    ("MFVec3f", "1 2 3", [[1, 2, 3]]),
    ("SFVec4f", "1 2 3 4", [1, 2, 3, 4]),
    ("SFRotation", "0 0 1 1.57", [0, 0, 1, 1.57]),
    ("MFColor", "[1 0 0 0 1 0]", [[1, 0, 0], [0, 1, 0]]),
    ("SFColorRGBA", "1 0 0 .5", [1, 0, 0, 0.5]),
    ("SFMatrix3f", "1 0 0 0 1 0 0 0 1", [1, 0, 0, 0, 1, 0, 0, 0, 1]),
    ("SFMatrix4d", "[1 0 0 0 0 1 0 0 0 0 1 0 5 6 7 1]", [*np.eye(4)[:3].ravel(), 5, 6, 7, 1]),
    ("MFFloat", "[]", []),
    ("MFString", "[ ]", []),
]


@pytest.mark.parametrize(("kind", "text", "expected"), FIELDS)
def test_every_type_is_read_in_either_form(kind: str, text: str, expected: object) -> None:
    node = parse(f"N {{ before 1 f {text} # comment ] }}\n behind 2 }}")
    found = read_field(node.fields["f"], kind)
    assert (found.tolist() if isinstance(found, np.ndarray) else found) == expected
    assert type(found) is type(expected) or isinstance(found, np.ndarray)
    # With a comment inside, a list is read word by word, with the same result.
    if text.startswith("[") and text.strip("[] "):
        node = parse(f"N {{ f [ #one ] \n {text[1:-1]} # two\n ] }}")
        again = read_field(node.fields["f"], kind)
        assert (again.tolist() if isinstance(again, np.ndarray) else again) == expected


@pytest.mark.parametrize(
    ("kind", "text", "message"),
    [
        ("SFFloat", "1 2", "found 2 numbers; expected one number"),
        ("SFFloat", '"1"', 'found "1"; expected numbers'),
        ("SFInt32", "1.5", "found 1.5; expected whole numbers"),
        ("SFVec3f", "1 2", "found 2 numbers; expected 3 numbers"),
        ("SFVec3f", "[]", "found nothing; expected 3 numbers"),
        ("MFVec4f", "[1 2 3]", "found 3 numbers; expected 4 for each entry"),
        ("SFBool", "1", "found 1; expected TRUE or FALSE"),
        ("SFString", "5", 'found 5; expected a quoted string, "..."'),
        ("SFString", '["a" "b"]', 'found 2 values; expected a quoted string, "..."'),
        ("MFString", '["a" 5 6]', 'found "a" 5 6; expected quoted strings, "..."'),
        ("SFNode", "Box {}", ""),
        ("SFNode", '"Box"', 'found "Box"; expected a node'),
        ("MFNode", "[Box {} 1]", "found Box 1; expected nodes"),
        ("MFFloat", "[1e999]", "found inf; expected finite numbers up to 1e+30"),
        ("SFFloat", "Box {}", "found Box; expected numbers"),
    ],
)
def test_value_of_another_type_is_reported(kind: str, text: str, message: str) -> None:
    value = parse(f"N {{ f {text} }}").fields["f"]
    if not message:
        assert isinstance(read_field(value, kind), Node)
        return
    with pytest.raises(ValueError) as caught:
        read_field(value, kind)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("text", "messages"),
    [
        ("Box { size }", ["scene.x3d:1: Box.size: found '}'; expected its value"]),
        ("Box { size 1 1 1", ["scene.x3d:1: the { of Box is not closed"]),
        ("Box size 1", ["scene.x3d:1: found 'size'; expected { after Box"]),
        ("\n}", ["scene.x3d:2: found '}'; expected a node, PROTO, EXTERNPROTO or ROUTE"]),
        (
            "DEF a Box { size 1.2.3 }\nBox { size “x” }",
            [
                "scene.x3d:1: a.size: found '1.2.3'; expected its value",
                "scene.x3d:2: Box.size: found '“x”'; expected its value (use \" as quotation mark)",
            ],
        ),
        (
            'A { name "x }\n',
            ["scene.x3d:1: A.name: found an unclosed \"; expected its value"],
        ),
        ("DEF lwr Box {}\nUSE lwt", [
            "scene.x3d:2: USE lwt: no preceding node has this name; did you mean 'lwr'?"]),
        ("DEF a Group { children USE a }", [
            "scene.x3d:1: USE a: the node would contain itself"]),
        ("ROUTE a.b c.d", ["scene.x3d:1: found 'c'; expected ROUTE node.event TO node.event"]),
        ("ROUTE a TO c.d", ["scene.x3d:1: found 'TO'; expected ROUTE node.event TO node.event"]),
        ("PROTO P [ field SFFlot x 1 ] { Box {} }", [
            "scene.x3d:1: no type 'SFFlot'; did you mean 'SFFloat'?"]),
        ("PROTO P [ feld SFFloat x 1 ] { Box {} }", [
            "scene.x3d:1: found 'feld'; expected field, eventIn, eventOut, exposedField; "
            "did you mean 'field'?"]),
        ("PROTO P [ field SFFloat x TRUE ] { Box {} }", [
            "scene.x3d:1: x: found TRUE; expected numbers"]),
        ("EXTERNPROTO P []", [
            "scene.x3d:1: EXTERNPROTO P: found the end of the file; expected its value"]),
        ("Box { size 1 1 1 size 2 2 2 }", ["scene.x3d:1: Box.size is set twice"]),
        ("Group { children [ Box {} ", [
            "scene.x3d:1: Group.children: found the end of the file; expected ] after the values",
            "scene.x3d:1: the { of Group is not closed"]),
        ("DEF a Group {\n children [\n DEF Transform { children [] } ] }\nSphere { radius }", [
            "scene.x3d:3: found '{'; expected the type of a node",
            "scene.x3d:4: Sphere.radius: found '}'; expected its value"]),
        ("Group { children " * 300, [
            "scene.x3d:1: nodes are nested more than 120 levels deep; expected fewer levels"]),
    ],
)  # fmt: skip
def test_errors_are_reported_with_lines(text: str, messages: list[str]) -> None:
    assert errors_in(text) == messages


def test_all_errors_are_reported_once() -> None:
    text = "Box { size ]\n }\nGroup { children [ Box { size 1 ]\n } ] }\nUSE x\nSphere { radius }\n"
    lines = [int(line.split(":")[1]) for line in errors_in(text)]
    assert lines == [1, 3, 5, 6]
    many = errors_in("Sphere { radius }\n" * 50)
    assert len(many) == 21 and many[-1] == "scene.x3d: and 30 more"


@pytest.mark.parametrize(
    ("contents", "message"),
    [
        (b"", "is empty; expected the first line `#X3D V3.0 utf8` or `#VRML V2.0 utf8`"),
        (b'<?xml version="1.0"?>\n<X3D/>', "is X3D in the XML encoding; expected the first line"),
        (b"#VRML V1.0 ascii\nSeparator {}\n", "is VRML V1.0, which precedes VRML97"),
        (b"solid cube\n", "begins with 'solid cube'; expected the first line `#X3D V3.0 utf8`"),
        (b"\x1f\x8bxx", "is a damaged gzip file"),
        (gzip.compress(b"#VRML V2.0 utf8\n")[:-9], "is a truncated gzip file"),
        (gzip.compress(b"#VRML V2.0 utf8\n" + b" " * 60_000_000),
         "is a gzip file with contents that are too large; expected at most 50 MB"),
    ],
    # Workers of pytest-xdist compare test names, and gzip output contains the time.
    ids=["empty", "xml", "vrml1", "stl", "damaged", "cut", "long"],
)  # fmt: skip
def test_other_file_formats_are_named(contents: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "a.wrl"
    path.write_bytes(contents)
    with pytest.raises(DeclarationError) as caught:
        read_document(path)
    assert str(caught.value).startswith(f"{path} {message}")


def test_parts_without_a_header_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.wrl"
    for text in ("Box {}", "# a part\n\nDEF b Box {}", "PROTO P [] { Box {} }\nBox {}"):
        path.write_text(text)
        assert read_document(path).nodes[0].kind == "Box"


def test_compressed_file_with_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.wrl"
    path.write_bytes(gzip.compress("\ufeff#VRML V2.0 utf8\nDEF größe Box {}".encode()))
    assert "größe" in read_document(path).names


@pytest.mark.slow
@pytest.mark.parametrize(
    "text",
    ["[" * 700_000, "}" * 30_000, "[1 a " * 30_000, '"' * 30_001, "a " * 30_000,
     "Shape { x [" + "1 " * 50_000, "A { x [ 1 a " * 5_000, "PROTO P [" * 20_000],
)  # fmt: skip
def test_long_invalid_text_takes_linear_time(text: str) -> None:
    began = time.process_time()
    with pytest.raises(DeclarationError):
        parse_document(text, HERE)
    assert time.process_time() - began < 4.0  # 5 s and more if it were quadratic


@pytest.mark.thorough
def test_nested_uses_and_protos_terminate(tmp_path: Path) -> None:
    uses = ["DEF a0 Group { children Shape { geometry Box {} } }"]
    uses += [f"DEF a{i} Group {{ children [ USE a{i - 1} USE a{i - 1} ] }}" for i in range(1, 40)]
    protos = ["PROTO P0 [] { Shape { geometry Box {} } }"]
    protos += [
        f"PROTO P{i} [] {{ Group {{ children [ P{i - 1} {{}} P{i - 1} {{}} ] }} }}"
        for i in range(1, 40)
    ]
    for k, lines in enumerate((uses, [*protos, "P39 {}"])):
        path = tmp_path / f"{k}.wrl"
        path.write_text("#VRML V2.0 utf8\n" + "\n".join(lines))
        many = "has more than 100,000 nodes, including those of every USE"
        with raises_with(file=str(path), reason=many):
            read_wrl(path)


_WORDS = st.sampled_from(
    ["{", "}", "[", "]", '"', "DEF", "USE", "ROUTE", "TO", ".", "PROTO", "EXTERNPROTO", "IS",
     "NULL", "TRUE", "1e400", "-", "Shape", "lwr", "field", "SFNode", "geometry", "children",
     "Inline", "url", "0", "-1", "#", "\n", "Transform", "scale 0 0 0", "coordIndex", "99999999",
     "SerialRobot", "baseFrame", "name", "Switch", "whichChoice", "Viewpoint", "rotation 0 0 0 1"]
)  # fmt: skip


@st.composite
def mutated(draw: st.DrawFn) -> str:
    """Returns a file in which words are removed, inserted and exchanged."""
    text = draw(st.sampled_from([WHOLE, FIG7.read_text("utf-8")]))
    words = text.split(" ")
    for _ in range(draw(st.integers(1, 6))):
        at = draw(st.integers(0, len(words) - 1))
        how = draw(st.integers(0, 3))
        if how == 0:
            words[at] = draw(_WORDS)
        elif how == 1:
            words.insert(at, draw(_WORDS))
        elif how == 2 and len(words) > 1:
            del words[at]
        else:
            words[at] = draw(st.text(max_size=6))
    return " ".join(words)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("mutated")


@settings(max_examples=120, deadline=None)
@given(text=mutated())
def test_mutated_file_is_read_or_reported(text: str, folder: Path) -> None:
    path = folder / "a.x3d"
    path.write_text("#X3D V3.0 utf8\n" + text, encoding="utf-8")
    for read in (read_x3d, read_wrl):
        try:
            read(path)
        except DeclarationError as error:
            assert all(problem.file for problem in error.problems)


def test_values_know_their_lines() -> None:
    node = parse("N {\n a 1\n b\n [ 2 ]\n}")
    assert [value.line for value in node.fields.values()] == [2, 4]
    assert isinstance(node.fields["a"], FieldValue)
