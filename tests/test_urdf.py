"""URDF files as tables of a robot, against an independent walk through the XML."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from conftest import raises_with
from hypothesis import given
from hypothesis import strategies as st

from sero_mj import DhTable, Scene, SerialRobot, World, load_scene
from sero_mj.base.errors import DeclarationError
from sero_mj.base.frames import Array, frame, rotation_about, rotation_from_rpy
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.robots.importers.imported_tables import ImportedTables
from sero_mj.robots.importers.urdf import UrdfFile, read_urdf

# A gripper on an arm: axes along and across, a fixed sensor with a mass, a mimic finger, odd names,
# a prismatic joint, a continuous one, global and local materials.
GRIPPER = """<?xml version="1.0"?>
<robot name="arm 1.0">
  <material name="red"><color rgba="0.8 0.1 0.1 1"/></material>
  <link name="base_link">
    <inertial><origin xyz="0 0 0.1"/><mass value="4"/>
      <inertia ixx="0.02" iyy="0.03" izz="0.025" ixy="0.001" ixz="0" iyz="-0.002"/></inertial>
    <visual><geometry><cylinder radius="0.1" length="0.2"/></geometry>
      <material name="red"/></visual>
    <collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision>
  </link>
  <joint name="turn.table" type="continuous">
    <parent link="base_link"/><child link="upper"/>
    <origin xyz="0.1 -0.2 0.3" rpy="0.2 -0.3 0.4"/><axis xyz="0 0 2"/>
    <dynamics damping="0.5" friction="0.1"/>
  </joint>
  <link name="upper">
    <inertial><origin xyz="0.05 0 0.1" rpy="0.1 0.2 0.3"/><mass value="2"/>
      <inertia ixx="0.01" iyy="0.012" izz="0.005" ixy="0" ixz="0.001" iyz="0"/></inertial>
    <visual><origin xyz="0 0 0.1" rpy="0 1.5 0"/><geometry><sphere radius="0.05"/></geometry>
      <material name="own"><color rgba="0 0.5 1 0.5"/></material></visual>
  </link>
  <joint name="sensor_joint" type="fixed">
    <origin xyz="0.3 0.1 0" rpy="0.5 0.1 -0.7"/><parent link="upper"/><child link="sensor"/>
  </joint>
  <link name="sensor">
    <inertial><origin xyz="0 0 0.02"/><mass value="0.5"/>
      <inertia ixx="0.001" iyy="0.001" izz="0.0015" ixy="0" ixz="0" iyz="0.0002"/></inertial>
    <visual><geometry><box size="0.1 0.05 0.02"/></geometry><material name="red"/></visual>
  </link>
  <joint name="slide" type="prismatic">
    <origin xyz="0 0.1 0.2" rpy="0 0.4 0"/><parent link="sensor"/><child link="lower"/>
    <axis xyz="0.6 0 -0.8"/><limit lower="0.1" upper="0.4" velocity="0.3" effort="200"/>
  </joint>
  <link name="lower"/>
  <joint name="finger a" type="revolute">
    <origin xyz="0 0.02 0.1"/><parent link="lower"/><child link="left"/>
    <axis xyz="-1 0 0"/><limit lower="-0.5" upper="1" velocity="2" effort="0"/>
  </joint>
  <link name="left"><inertial><mass value="0.1"/>
      <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="finger-b" type="revolute">
    <origin xyz="0 -0.02 0.1"/><parent link="lower"/><child link="right"/>
    <axis xyz="0 1 0"/><limit lower="-0.5" upper="1" velocity="2" effort="0"/>
    <mimic joint="finger a" multiplier="-2" offset="0.25"/>
  </joint>
  <link name="right"><inertial><mass value="0.1"/>
      <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>
"""
CHAIN = GRIPPER[: GRIPPER.index('  <joint name="finger a"')] + "</robot>\n"


def write(folder: Path, text: str, name: str = "robot.urdf") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def described(tmp_path: Path, text: str, **more: Any) -> ImportedTables:
    return read_urdf(write(tmp_path, text), **more)


def problems(tmp_path: Path, text: str) -> list[str]:
    """Returns the problems of a file without its folder."""
    with pytest.raises(DeclarationError) as caught:
        described(tmp_path, text)
    return [str(problem).replace(f"{tmp_path}/", "") for problem in caught.value.problems]


def floats(element: ElementTree.Element | None, name: str, default: str = "0 0 0") -> Array:
    text = default if element is None else element.get(name, default)
    return np.array([float(word) for word in text.split()])


def origin(element: ElementTree.Element) -> Array:
    found = element.find("origin")
    return frame(rotation_from_rpy(floats(found, "rpy")), floats(found, "xyz"))


def about(axis: Array, angle: float) -> Array:
    """Returns the rotation about any axis by Rodrigues' formula."""
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def poses_in_xml(text: str, values: dict[str, float]) -> dict[str, Array]:
    """Returns T_base_link of every link of a URDF."""
    root = ElementTree.fromstring(text)
    below: dict[str, list[ElementTree.Element]] = {}
    children = set()
    for joint in root.findall("joint"):
        below.setdefault(joint.find("parent").get("link"), []).append(joint)  # type: ignore
        children.add(joint.find("child").get("link"))  # type: ignore
    (base,) = [
        link.get("name") for link in root.findall("link") if link.get("name") not in children
    ]
    found, waiting = {base: np.eye(4)}, [base]
    while waiting:
        parent = waiting.pop()
        for joint in below.get(parent, []):
            child = joint.find("child").get("link")  # type: ignore
            axis = floats(joint.find("axis"), "xyz", "1 0 0")
            value = values.get(joint.get("name"), 0.0)
            moved = np.eye(4)
            if joint.get("type") == "prismatic":
                moved[:3, 3] = value * axis / np.linalg.norm(axis)
            elif joint.get("type") != "fixed":
                moved[:3, :3] = about(axis, value)
            found[child] = found[parent] @ origin(joint) @ moved
            waiting.append(child)
    return found


def poses_in_tables(tables: dict[str, Any], q: Array) -> Array:
    """Returns T_base_body of the base and every link of the tables."""
    names = tables["joint_names"]
    revolute = np.array([kind == "revolute" for kind in tables["joint_types"]])
    if "dh_params" in tables:
        table = DhTable.from_rows(tables["dh_params"], tables["dh_convention"], revolute=revolute)
        found = table.frames(q, np.array(tables.get("dh_base_frame", np.eye(4)))).copy()
        found[0] = np.eye(4)
        return found
    parents = tables.get("parents", ["base", *names[:-1]])
    poses = {"base": np.eye(4)}
    for name, parent, T, turns, value in zip(
        names, parents, tables["joint_frames"], revolute, q, strict=True
    ):
        moved = frame(rotation_about(2, value)) if turns else frame(position=[0, 0, value])
        poses[name] = poses[parent] @ np.array(T) @ moved
    return np.array([*poses.values()])


@pytest.mark.parametrize("text", [GRIPPER, CHAIN])
def test_links_have_the_poses_of_the_file(tmp_path: Path, text: str) -> None:
    file = UrdfFile(write(tmp_path, text))
    tables = file.described.tables
    assert ("dh_params" in tables) == (text == CHAIN)
    for q in np.random.default_rng(0).uniform(-2, 2, (20, len(tables["joint_names"]))):
        values = {joint.name: value for joint, value in zip(file.tree.joints, q, strict=True)}
        found = poses_in_tables(tables, q)
        for link, T in poses_in_xml(text, values).items():
            body, T_body_link = file.tree.T_body_link[link]
            assert np.allclose(found[body] @ T_body_link, T, rtol=0, atol=1e-9)


def points_of(mass: float, center: Array, tensor: Array) -> tuple[Array, Array]:
    """Returns six point masses with a body's mass, center and tensor."""
    moments, axes = np.linalg.eigh(np.trace(tensor) / 2 * np.eye(3) - tensor)
    away = (axes * np.sqrt(3 * moments / mass)).T
    return np.concatenate([center + away, center - away]), np.full(6, mass / 6)


@pytest.mark.parametrize("text", [GRIPPER, CHAIN])
def test_inertias_equal_those_of_the_point_masses_of_all_links(tmp_path: Path, text: str) -> None:
    tables = described(tmp_path, text).tables
    dynamics = tables["dynamics"]
    q = np.array([0.3, 0.2, -0.4, 0.7])[: len(tables["joint_names"])]
    names = ["turn.table", "slide", "finger a", "finger-b"][: len(q)]
    at = poses_in_xml(text, dict(zip(names, q, strict=True)))
    points, masses = [], []
    for link in ElementTree.fromstring(text).findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        mass = float(floats(inertial.find("mass"), "value")[0])
        xx, yy, zz, xy, xz, yz = (
            float(inertial.find("inertia").get(name))  # type: ignore
            for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        )
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        local, each = points_of(mass, np.zeros(3), tensor)
        T = at[link.get("name")] @ origin(inertial)
        points.append(local @ T[:3, :3].T + T[:3, 3])
        masses.append(each)
    ours, our_masses = [], []
    for T, mass, center, six in zip(
        poses_in_tables(tables, q), dynamics["masses"], dynamics["centers_of_mass"],
        dynamics["inertias"], strict=True,
    ):  # fmt: skip
        if mass:
            xx, yy, zz, xy, xz, yz = six
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            local, each = points_of(mass, np.array(center), tensor)
            ours.append(local @ T[:3, :3].T + T[:3, 3])
            our_masses.append(each)
    for power in (0, 1, 2):
        sums = []
        for p, m in ((points, masses), (ours, our_masses)):
            cloud, weights = np.concatenate(p), np.concatenate(m)
            sums.append(
                [weights.sum(), weights @ cloud, (weights[:, None] * cloud).T @ cloud][power]
            )
        assert np.allclose(*sums, rtol=1e-9, atol=1e-12)
    assert dynamics["masses"][:2] == [4.0, 2.5]


def test_limits_couplings_colors_and_shapes_are_read(tmp_path: Path) -> None:
    read = described(tmp_path, GRIPPER)
    tables = read.tables
    assert tables["name"] == "arm_1_0"
    assert tables["joint_names"] == ["turn.table", "slide", "finger a", "finger-b"]
    assert tables["joint_types"] == ["revolute", "prismatic", "revolute", "revolute"]
    assert tables["parents"] == ["base", "turn.table", "slide", "slide"]
    inf = np.inf
    assert tables["position_limits"] == [[-inf, inf], [0.1, 0.4], [-0.5, 1.0], [-0.5, 1.0]]
    assert tables["velocity_limits"] == [inf, 0.3, 2.0, 2.0]
    assert tables["torque_limits"] == [inf, 200.0, inf, inf]  # zero means no limit
    assert tables["couplings"] == {"finger-b": {"to": "finger a", "ratio": -2.0, "offset": 0.25}}
    assert tables["joint_angles"] == [0.0, 0.1, 0.0, 0.25]  # where 0 is out of range
    assert tables["dynamics"]["viscous_friction"] == [0.5, 0, 0, 0]
    assert tables["dynamics"]["coulomb_friction"] == [0.1, 0, 0, 0]
    assert tables["colors"] == {"red": [0.8, 0.1, 0.1, 1.0], "own": [0.0, 0.5, 1.0, 0.5]}
    base, upper, *rest = tables["filenames"]
    assert base == [{"shape": "cylinder", "size": [0.1, 0.2], "color": "red"}]
    assert [each["color"] for each in upper] == ["own", "red"]
    assert upper[0]["size"] == [0.05] and upper[1]["size"] == [0.1, 0.05, 0.02]
    assert np.allclose(np.array(upper[0]["frame"])[:3, 3], [0, 0, 0.1])
    assert rest == [[], [], []]
    assert tables["collisions"] == [[{"shape": "box", "size": [0.2, 0.2, 0.2]}], [], [], [], []]
    # The flange is on the hand, not on one of its fingers.
    assert tables["flange_on"] == "slide"
    lines = GRIPPER.splitlines()
    for key, text in (
        ("joint_names.2", 'joint name="finger a"'),
        ("filenames.1.1", "box size"),
        ("torque_limits.1", "limit lower"),
        ("couplings.finger-b", 'joint name="finger-b"'),
        ("dynamics.masses.1", 'link name="upper"'),
    ):
        assert text in lines[read.lines[key] - 1], key
    assert read.warnings == [
        "moving links without mass: 'lower'",
    ]


@pytest.mark.parametrize("flange", ["tool0", "left/end_effector_link"])
def test_chain_has_a_dh_table_and_its_flange(flange: str, tmp_path: Path) -> None:
    text = CHAIN.replace(
        "</robot>",
        '<joint name="t" type="fixed"><origin xyz="0 0 0.1" rpy="0 0 1"/><parent link="lower"/>'
        f'<child link="{flange}"/></joint><link name="{flange}"/>'
        '<joint name="c" type="fixed"><parent link="lower"/><child link="camera_link"/></joint>'
        '<link name="camera_link"/></robot>',
    )
    file = UrdfFile(write(tmp_path, text))
    tables = file.described.tables
    assert file.tree.flange == flange
    assert "joint_frames" not in tables and "parents" not in tables
    q = np.array([0.4, 0.3])
    T = poses_in_tables(tables, q)[-1] @ np.array(tables["flange_frame"])
    expected = poses_in_xml(text, {"turn.table": 0.4, "slide": 0.3})[flange]
    assert np.allclose(T, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("kind", "axis", "free_base", "normal"),
    [
        ("floating", "", True, None),
        ("planar", '<axis xyz="0 0 2"/>', "planar", None),
        ("planar", "", "planar", [1, 0, 0]),  # the default of the specification
    ],
)
def test_floating_or_planar_root_is_a_free_base(
    kind: str, axis: str, free_base: object, normal: object, tmp_path: Path
) -> None:
    above = (
        '<link name="world"/><link name="odom"><visual><geometry><sphere radius="1"/></geometry>'
        '</visual></link><joint name="w" type="fixed"><parent link="world"/><child link="odom"/>'
        f'<origin xyz="0 0 1"/></joint><joint name="root joint" type="{kind}">{axis}<parent '
        'link="odom"/><child link="base_link"/><origin xyz="1 0 0" rpy="0 0 1"/></joint>'
    )
    read = described(tmp_path, GRIPPER.replace("  <link", f"{above}<link", 1))
    tables, plain = read.tables, described(tmp_path, GRIPPER).tables
    assert (tables["free_base"], tables["base_joint"]) == (free_base, "root_joint")
    assert tables.get("base_normal") == normal
    expected = frame(rotation_from_rpy(np.array([0, 0, 1])), [1, 0, 1])
    np.testing.assert_allclose(tables["base_frame"], expected)
    ours = {"free_base", "base_joint", "base_normal", "base_frame"}
    assert {key: value for key, value in tables.items() if key not in ours} == plain
    assert "links that 'root joint' does not move are left out: 'odom'" in read.warnings


def test_inner_planar_joints_become_three_and_floating_ones_are_fixed(
    tmp_path: Path,
) -> None:
    more = (
        '<joint name="sled" type="planar"><parent link="base_link"/><child link="plate"/>'
        '<origin xyz="0 0 1" rpy="0 0 1"/><axis xyz="0 1 0"/></joint><link name="plate"/>'
        '<joint name="loose" type="floating"><parent link="plate"/><child link="ball"/>'
        '<origin xyz="0 0 0.5"/></joint><link name="ball"/></robot>'
    )
    text = GRIPPER.replace("</robot>", more)
    file = UrdfFile(write(tmp_path, text))
    names = file.described.tables["joint_names"]
    q = np.zeros(len(names))
    q[[names.index(f"sled_{axis}") for axis in ("x", "y", "yaw")]] = 0.3, 0.2, 0.4
    body, T_body_ball = file.tree.T_body_link["ball"]
    T = poses_in_tables(file.described.tables, q)[body] @ T_body_ball
    turned = poses_in_xml(text, {"sled": 0.4})["ball"]
    np.testing.assert_allclose(T[:3, :3], turned[:3, :3], atol=1e-12)
    moved = T[:3, 3] - turned[:3, 3]
    normal = about(np.array([0, 0, 1]), 1.0) @ [0, 1, 0]
    assert moved @ normal == pytest.approx(0, abs=1e-12)
    assert np.linalg.norm(moved) == pytest.approx(np.hypot(0.3, 0.2))
    assert "floating joints inside a robot become fixed joints at their origins: 'loose'" in (
        file.described.warnings
    )


def test_scene_has_a_robot_of_a_urdf_file(tmp_path: Path) -> None:
    path = write(tmp_path, GRIPPER)
    scene = write(tmp_path, '[robots.arm]\nmodel = "robot.urdf"\nshow_arrows = true', "s.toml")
    robot = load_scene(scene).robots["arm"]
    assert robot.names == described(tmp_path, GRIPPER).tables["joint_names"] and robot.show_arrows
    overridden = load_scene(path, {"robot.base_frame": {"xyz": [0, 0, 1]}}).robots["robot"]
    assert overridden.base_frame[2, 3] == 1


BAD = """<robot name="bad">
  <link name="a"><inertial><mass value="-1"/></inertial></link>
  <link name="b"><visual><geometry><boxx size="1 1 1"/></geometry></visual>
    <inertial><mass value="1"/><inertia ixx="one" iyy="1" izz="1"/></inertial></link>
  <link name="b"/>
  <link/>
  <joint name="j1" type="revolut"><parent link="a"/><child link="b"/></joint>
  <joint name="j2" type="revolute"><parent link="a"/><child link="bb"/>
    <axis xyz="0 0 0"/></joint>
  <joint name="j3" type="revolute"><parent link="a"/>
    <child link="b"/><axis xyz="0 0 0"/>
    <limit lower="1" upper="-1" velocity="-1" effort="1"/></joint>
  <joint name="j4" type="prismatic"><child link="b"/><origin xyz="0 0" rpy="0 nan 0"/></joint>
  <joint name="j3" type="fixed"/>
</robot>
"""


def test_all_errors_are_reported_at_once_with_lines(tmp_path: Path) -> None:
    assert problems(tmp_path, BAD) == [
        "robot.urdf:2: link 'a': <mass>: found -1 kg; expected 0 or more",
        "robot.urdf:3: link 'b': <visual>: unknown geometry <boxx>; did you mean 'box'?",
        "robot.urdf:4: link 'b': <inertia>: found ixx = 'one'; expected 1 number",
        "robot.urdf:5: link 'b' is already defined in line 3",
        'robot.urdf:6: link has no name; expected name="..."',
        "robot.urdf:7: joint 'j1': found type 'revolut'; did you mean 'revolute'?",
        "robot.urdf:8: joint 'j2': <child>: no link 'bb'; did you mean 'b'?",
        "robot.urdf:11: joint 'j3': <axis>: found 0 0 0; expected a nonzero vector",
        "robot.urdf:12: joint 'j3': <limit>: found velocity = -1; expected 0 or more",
        "robot.urdf:13: joint 'j4' has no <parent link=\"...\">",
        "robot.urdf:13: joint 'j4': <origin>: found xyz = '0 0'; expected 3 numbers",
        "robot.urdf:13: joint 'j4': <origin>: found rpy = '0 nan 0'; expected 3 numbers",
        "robot.urdf:14: joint 'j3' is already defined in line 10",
    ]  # fmt: skip


def joint(name: str, parent: str, child: str, kind: str = "revolute") -> str:
    return (
        f'\n<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1"/></joint>'
    )


LINKS = "<robot name='r'>" + "".join(f'<link name="{name}"/>' for name in "abcd")


@pytest.mark.parametrize(
    ("joints", "expected"),
    [
        (
            joint("1", "a", "b") + joint("2", "c", "b") + joint("3", "b", "d"),
            ["robot.urdf:3: joint '2': link 'b' is already the child of joint '1'; expected "
             "one parent joint per link"],
        ),
        (
            joint("1", "a", "b") + joint("2", "b", "c"),
            ["robot.urdf:1: link 'd' is not the child of a joint, but the base is 'a'; "
             "expected a single base"],
        ),
        (
            joint("1", "a", "b") + joint("2", "c", "d") + joint("3", "d", "c"),
            ["robot.urdf:1: link 'c': the joints form a loop: 'c', 'd'; expected a tree"],
        ),
        (
            "".join(joint(a + b, a, b, "fixed") for a, b in ("ab", "bc", "cd")),
            ["robot.urdf:1: robot has no movable joint; expected one or more. Add a rigid body "
             'to a scene as an object with urdf = "robot.urdf"'],
        ),
    ],
)  # fmt: skip
def test_joints_that_do_not_form_a_tree_are_rejected(
    tmp_path: Path, joints: str, expected: list[str]
) -> None:
    assert problems(tmp_path, f"{LINKS}{joints}\n</robot>") == expected


ENTITIES = "".join(
    f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "robot.urdf:1: not valid XML: Document is empty"),
        ("solid model", "robot.urdf:1: not valid XML: Start tag expected"),
        ("<robot>\n<link>\n</robot>", "robot.urdf:3: not valid XML: Opening and end"),
        ("<robot>" + "<a>" * 400, "robot.urdf:1: not valid XML: Excessive depth"),
        (f'<!DOCTYPE r [<!ENTITY a "lol">{ENTITIES}]><robot name="&i;"/>', "declares entities"),
        ('<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot>&a;</robot>',
         "robot.urdf: not valid XML: it declares entities ('a')"),
        ("\n<mujoco/>",
         "robot.urdf:2: is an MJCF file; expected a URDF file, whose root is <robot>"),
        ("<robot/>", "robot.urdf:1: robot has no <link>"),
    ],
)  # fmt: skip
def test_files_that_are_not_urdf_are_rejected(tmp_path: Path, text: str, expected: str) -> None:
    found = problems(tmp_path, text)
    assert expected in found[0]


@pytest.mark.parametrize(
    ("change", "warning"),
    [
        (lambda text: text.replace('"1.0"', '"0.0"', 1), '<?xml version="0.0"?>'),
        (lambda text: f"<!-- made by hand -->\n\n{text}", '<?xml version="1.0"?>'),
        (
            lambda text: text.replace("</robot>", "<sensor:camera a:b='1'/></robot>"),
            "undeclared prefixes: a, sensor",
        ),
    ],
)
def test_slightly_invalid_xml_is_read(
    tmp_path: Path, change: Callable[[str], str], warning: str
) -> None:
    whole = described(tmp_path, GRIPPER)
    read = described(tmp_path, change(GRIPPER))
    np.testing.assert_equal(read.tables, whole.tables)
    (told,) = [each for each in read.warnings if each not in whole.warnings]
    assert warning in told


@pytest.mark.parametrize("start", ['<?xml version="0.0"?>', '\n<?xml version="1.0"?>'])
def test_slightly_invalid_xml_is_checked_like_valid_xml(tmp_path: Path, start: str) -> None:
    (found,) = problems(tmp_path, f'{start}<!DOCTYPE r [<!ENTITY a "b">]><robot name="&a;"/>')
    assert "declares entities ('a')" in found
    (depth,) = problems(tmp_path, f"{start}<robot>" + "<s:a>" * 400)
    assert "Excessive depth" in depth
    (mismatch,) = problems(tmp_path, f"{start}\n<robot><s:link></robot>")
    line = start.count("\n") + 2
    assert f"robot.urdf:{line}: not valid XML: Opening and ending tag" in mismatch


def test_misplaced_declaration_sets_the_encoding(tmp_path: Path) -> None:
    text = '\n<?xml version="1.0" encoding="ISO-8859-1"?>' + GRIPPER.partition("?>")[2]
    path = tmp_path / "robot.urdf"
    path.write_bytes(text.replace('"lower"', '"nächster"').encode("latin-1"))
    assert "nächster" in read_urdf(path).tables["link_names"]


def test_encodings_can_have_python_names(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    for start in ("", "\n"):
        text = f'{start}<?xml version="1.0" encoding="latin-1"?>' + GRIPPER.partition("?>")[2]
        path.write_bytes(text.replace('"lower"', '"nächster"').encode("latin-1"))
        assert "nächster" in read_urdf(path).tables["link_names"]
    (found,) = problems(tmp_path, '<?xml version="1.0" encoding="latin-x"?><robot/>')
    assert "latin-x" in found


def test_unambiguous_misspelled_numbers_are_read(tmp_path: Path) -> None:
    whole = described(tmp_path, GRIPPER)
    text = GRIPPER.replace('xyz="0.3 0.1 0"', 'xyz="0.3, 0.1,0"')
    read = described(tmp_path, text.replace('lower="-0.5"', 'lower="-0.5."', 1))
    np.testing.assert_equal(read.tables["joint_frames"], whole.tables["joint_frames"])
    assert read.tables["position_limits"] == whole.tables["position_limits"]
    told = [each for each in read.warnings if each not in whole.warnings]
    assert sorted(each.partition(":")[0] for each in told) == [
        "'-0.5.' is read as -0.5",
        "'0.3, 0.1,0' is read as 0.3 0.1 0",
    ]
    for wrong in ("0,3 0.1 0", "0,3 0,1", "0.3,,0.1,0", "0.3, 0.1", "0.3.1 0 0", "1,2,3,4"):
        (found,) = problems(tmp_path, GRIPPER.replace('xyz="0.3 0.1 0"', f'xyz="{wrong}"'))
        assert f"found xyz = '{wrong}'; expected 3 numbers" in found


def test_plain_files_use_environment_variables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = described(tmp_path, GRIPPER)
    text = GRIPPER.replace('xyz="0.3 0.1 0"', 'xyz="$(optenv SENSOR_XYZ 0.3 0.1 0)"')
    assert described(tmp_path, text).tables == whole.tables
    (found,) = problems(tmp_path, text.replace("optenv SENSOR_XYZ 0.3 0.1 0", "env SENSOR_XYZ"))
    assert (
        "<origin>: found $(env SENSOR_XYZ), but the environment variable SENSOR_XYZ is not set"
        in found
    )
    monkeypatch.setenv("SENSOR_XYZ", "0.3 0.1 0")
    for name in ("optenv SENSOR_XYZ", "optenv SENSOR_XYZ 1 1 1", "env SENSOR_XYZ"):
        filled = text.replace("optenv SENSOR_XYZ 0.3 0.1 0", name)
        assert described(tmp_path, filled).tables == whole.tables


def test_implausible_numbers_are_ignored_separately(tmp_path: Path) -> None:
    text = (
        GRIPPER.replace('lower="-0.5" upper="1"', 'lower="1" upper="-0.5"', 1)
        .replace('<mass value="2"/>', "")
        .replace('xyz="0.3 0.1 0"', 'xyz="0.3 0.1 0 1"')
        .replace('damping="0.5"', 'damping="1e11"')
        .replace('lower="0.1" upper="0.4"', 'lower="-999999" upper="999999"')
    )
    whole, read = described(tmp_path, GRIPPER), described(tmp_path, text)
    names = whole.tables["joint_names"]
    assert read.tables["joint_names"] == names
    limits = dict(zip(names, read.tables["position_limits"], strict=True))
    assert limits["finger a"] == limits["slide"] == [-np.inf, np.inf]
    assert limits["finger-b"] == [-0.5, 1]
    np.testing.assert_equal(read.tables["joint_frames"], whole.tables["joint_frames"])
    assert read.tables["dynamics"]["viscous_friction"][0] == 1e9
    assert read.tables["dynamics"]["masses"][1] == 0.5  # of the sensor that is fixed there
    told = [each for each in read.warnings if each not in whole.warnings]
    assert told == [
        "<inertial> without <mass value=...> is ignored: link 'upper' (line 17)",
        "damping is clipped to 1e+09: joint 'turn.table' (line 14)",
        "extra values of xyz are ignored: joint 'sensor_joint' (line 23)",
        "limits of 1000 rad or m and more are ignored: 'slide' (line 32)",
        "joints with swapped limits are treated as unlimited: 'finger a' (line 37)",
    ]


def test_nearly_flat_tensor_is_raised(tmp_path: Path) -> None:
    flat = '<inertia ixx="0.2125" ixy="-0.005" ixz="0.0225" iyy="0.205" iyz="0.045" izz="0.0125"/>'
    own = '<inertia ixx="0.01" iyy="0.012" izz="0.005" ixy="0" ixz="0.001" iyz="0"/>'
    path = write(tmp_path, CHAIN.replace(own, flat))
    World(load_scene(path), dynamic=True)


SLIDE = """<robot name="slide"><link name="a"/><link name="b"/><link name="c"/>
<joint name="turn" type="continuous"><parent link="a"/><child link="b"/>
<origin xyz="0 0 0.4"/><axis xyz="0 0 1"/></joint>
<joint name="slide" type="prismatic"><parent link="b"/><child link="c"/><axis xyz="1 0 0"/>
<origin xyz="0.2 0 0.1"/><limit lower="-{0}" upper="{0}"/></joint></robot>"""


def test_mass_does_not_grow_with_prismatic_travel(tmp_path: Path) -> None:
    found = {}
    for travel in (0.1, 1, 100, 999_999):
        robot = load_scene(write(tmp_path, SLIDE.format(travel))).robots["robot"]
        found[travel] = robot_dynamics(robot).masses
    assert 0.1 < found[0.1].sum() < 10
    for masses in found.values():
        np.testing.assert_allclose(masses, found[0.1])
    assert robot.reach < 1.0  # without limits, because 999,999 m count as none


BALL = """<robot name="a ball"><link name="ball">
<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1"/></inertial>
<visual><origin xyz="0 0 0.5"/><geometry><mesh filename="cube.obj" scale="0.1 0.2 0.3"/></geometry>
<material name="red"><color rgba="1 0 0 1"/></material></visual>
<collision><origin xyz="0 0 0.5"/><geometry><sphere radius="0.15"/></geometry></collision></link>
<link name="pole"><visual><geometry><cylinder radius="0.01" length="1"/></geometry></visual></link>
<joint name="held" type="fixed"><parent link="ball"/><child link="pole"/><origin xyz="0 0 -0.2"/>
</joint></robot>"""
CUBE = "".join(f"v {x} {y} {z}\n" for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)) + (
    "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
)


def test_file_without_joints_is_an_object(tmp_path: Path) -> None:
    path = write(tmp_path, BALL, "ball.urdf")
    (tmp_path / "cube.obj").write_text(CUBE)
    scene = load_scene(path, {"ball.frame": {"xyz": [1, 0, 0]}})
    assert (list(scene.robots), [item.name for item in scene.objects]) == ([], ["ball"])
    world = World(scene)
    data = world.make_data()
    geoms = [k for k in range(world.model.ngeom) if world.model.geom_bodyid[k]]
    at = {int(world.model.geom_type[k]): data.geom_xpos[k] for k in geoms}
    kinds = mujoco.mjtGeom
    np.testing.assert_allclose(at[int(kinds.mjGEOM_MESH)], [1, 0, 0.5], atol=1e-9)
    np.testing.assert_allclose(at[int(kinds.mjGEOM_SPHERE)], [1, 0, 0.5])
    np.testing.assert_allclose(at[int(kinds.mjGEOM_CYLINDER)], [1, 0, -0.2])
    touching = [world.model.geom_type[k] for k in geoms if world.model.geom_contype[k]]
    assert touching == [int(kinds.mjGEOM_SPHERE)]
    assert world.model.geom("floor").pos[2] == pytest.approx(-0.7)  # as low as the pole reaches
    beside = '[robots.lwr]\nmodel = "lwr"\n[[robots.lwr.children]]\nname = "b"\nurdf = "ball.urdf"'
    World(load_scene(write(tmp_path, beside, "s.toml")))


def test_mjcf_without_joints_is_an_object(tmp_path: Path) -> None:
    text = '<mujoco><worldbody><geom name="top" type="box" size="1 1 .1"/></worldbody></mujoco>'
    scene = load_scene(write(tmp_path, text, "table.xml"))
    assert [item.name for item in scene.objects] == ["table"]
    assert World(scene).model.geom("table/top").size[2] == 0.1


def test_missing_file_and_folder_are_reported(tmp_path: Path) -> None:
    folder = "cannot be read: Is a directory"
    for path, reason in ((tmp_path / "no.urdf", "no such file"), (tmp_path, folder)):
        with raises_with(file=str(path), reason=reason):
            read_urdf(path)


XACRO = """<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:property name="length" value="0.25"/>
<link name="a"/><link name="b"/>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
<origin xyz="0 0 ${2 * length}"/><limit lower="-1" upper="1"/></joint>
</robot>"""


def test_xacro_is_expanded_if_installed(tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    tables = described(tmp_path, XACRO).tables
    assert np.array(tables["flange_frame"])[:3, 3].tolist() == [0, 0, 0.5]
    wrong = XACRO.replace("2 * length", "2 * lenth")
    assert "xacro cannot expand the file" in problems(tmp_path, wrong)[0]
    included = XACRO.replace("<link", '<xacro:include filename="$(find odd)/x.xacro"/><link', 1)
    assert (
        "package 'odd' not found; set its folder with --package odd=DIR"
        in problems(tmp_path, included)[0]
    )


def test_xacro_elements_in_another_namespace_are_reported(tmp_path: Path) -> None:
    text = XACRO.replace("http://www.ros.org/wiki/xacro", "http://other")
    path = tmp_path / "x.urdf"
    path.write_text(text.replace("${2 * length}", "0.5"))
    (warning,) = [each for each in read_urdf(path).warnings if "xacro" in each]
    assert warning == (
        'xacro elements are ignored; add xmlns:xacro="http://www.ros.org/wiki/xacro" to expand '
        "them: "
        "<xacro:property> (line 2)"
    )


def test_threads_expand_xacro_with_separate_packages(tmp_path: Path) -> None:
    substitution = pytest.importorskip("xacro.substitution_args")
    find = substitution._eval_find
    include = '<xacro:include filename="$(find parts)/length.xacro"/><link'
    robot = XACRO.replace('<xacro:property name="length" value="0.25"/>', "")
    (tmp_path / "robot.urdf.xacro").write_text(robot.replace("<link", include, 1))
    for k in range(1, 5):
        (tmp_path / str(k)).mkdir()
        (tmp_path / str(k) / "length.xacro").write_text(
            '<robot xmlns:xacro="http://www.ros.org/wiki/xacro">'
            f'<xacro:property name="length" value="{k}"/></robot>'
        )

    def length(k: int) -> float:
        read = read_urdf(tmp_path / "robot.urdf.xacro", packages={"parts": tmp_path / str(k)})
        return float(np.array(read.tables["flange_frame"])[2, 3])

    order = [1, 2, 3, 4] * 10
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(length, order)) == [2.0 * k for k in order]
    assert substitution._eval_find is find


def test_missing_xacro_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xacro", None)
    (found,) = problems(tmp_path, XACRO)
    assert "is a xacro file. Install the xacro reader with `pip install sero-mj[xacro]`" in found
    # Only if xacro is used: files made by xacro still declare its namespace.
    assert described(tmp_path, GRIPPER.replace("<robot", '<robot xmlns:xacro="xacro"'))


def test_ignored_mimics_and_limits_are_reported(tmp_path: Path) -> None:
    text = GRIPPER.replace('joint="finger a" mult', 'joint="finger_a" mult').replace(
        'lower="0.1" upper="0.4"', 'lower="0" upper="0"'
    )
    read = described(tmp_path, text)
    assert "couplings" not in read.tables
    assert read.tables["position_limits"][1] == [-np.inf, np.inf]
    line = text[: text.index('name="finger-b"')].count("\n") + 1
    mimic = f"'finger-b' (line {line}): no joint 'finger_a'; did you mean 'finger a'?"
    assert f"ignored <mimic> elements: {mimic}" in read.warnings
    limits = [warning for warning in read.warnings if "equal limits" in warning]
    assert limits == ["joints with equal limits are treated as unlimited: 'slide' (line 32)"]


WORDS = ["0", "1", "-1", "nan", "1e400", "", "a", "revolute", "fixed", "upper", "lower", "slide"]


@given(st.data())
def test_mutated_files_raise_only_declaration_errors(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.getbasetemp() / "mutated.urdf"
    text = GRIPPER
    for _ in range(data.draw(st.integers(1, 4))):
        kind = data.draw(st.sampled_from(["cut", "word", "element", "character"]))
        start = data.draw(st.integers(0, max(len(text) - 1, 0)))
        if kind == "cut":
            text = text[:start] + text[start + data.draw(st.integers(1, 60)) :]
        elif kind == "character":
            text = text[:start] + data.draw(st.characters(exclude_categories=["Cs"])) + text[start:]
        else:
            root = ElementTree.fromstring(GRIPPER)
            each = data.draw(st.sampled_from([*root.iter()]))
            if kind == "word" and each.attrib:
                name = data.draw(st.sampled_from(sorted(each.attrib)))
                each.set(name, data.draw(st.sampled_from(WORDS)))
            else:
                each[:] = data.draw(st.permutations([*each]))[1:]
            text = ElementTree.tostring(root, encoding="unicode")
    path.write_text(text, encoding="utf-8")
    try:
        tables = read_urdf(path).tables
    except DeclarationError as error:
        assert str(error)
    else:
        assert len(tables["joint_names"]) >= 1


@pytest.mark.parametrize("names", [
    ["1", "2", "3"], ["left/j1", "left/j2", "left_j2"], ["a.b", "base", "r::j1"],
    ["hüfte", "关节一", "関節"],
], ids=" ".join)  # fmt: skip
def test_joints_have_the_names_of_the_file(tmp_path: Path, names: list[str]) -> None:
    kinds = dict(zip(("turn.table", "slide", "finger a"), names, strict=True))
    text = GRIPPER
    for ours, theirs in kinds.items():
        text = text.replace(f'"{ours}"', f'"{theirs}"')
    path = write(tmp_path, text)
    robot = SerialRobot.from_model(str(path))
    assert robot.names == [*names, "finger-b"]
    assert robot.carriers.tolist() == [0, 1, 2, 2]  # the joint `base` is not the base
    world = World(Scene(robots=[robot]))
    for k, name in enumerate(names):
        assert world.model.joint(f"{robot.name}/{name}").id == k
        assert robot.frame_label(name) == ("base" if name == "base" else f"link{k + 1}")
    # In routes, identifiers stand for other names if that is unambiguous.
    assert robot.frame_label("left_j1") == ("link1" if "left/j1" in names else "left_j1")
    assert robot.frame_label("left_j2") == ("link3" if "left/j1" in names else "left_j2")
