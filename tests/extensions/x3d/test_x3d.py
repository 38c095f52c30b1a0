"""Scenes in X3D's classic encoding: Fig. 7 as printed in the paper, and other contents."""

from __future__ import annotations

import logging
import socket
import struct
from pathlib import Path

import mujoco
import numpy as np
import pytest
from conftest import ROOT
from polling import until

from sero_mj import DeclarationError, Mirror, World, load_scene, record_sources
from sero_mj.base.frames import Array
from sero_mj.cli import main
from sero_mj.data.receive.udp import UdpReceiver
from sero_mj.extensions.x3d.reader import read_x3d
from sero_mj.robots.importers.imported_tables import ImportedTables
from sero_mj.simulate.runs.run_recording import read_run

FIG7 = ROOT / "tests" / "fig7.x3d"
# The rows as printed in the paper.
LWR = [
    [0, 0, 0, 0.31], [1.5708, 0, 0, 0], [-1.5708, 0, 0, 0.4], [-1.5708, 0, 0, 0],
    [1.5708, 0, 0, 0.39], [1.5708, 0, 0, 0], [-1.5708, 0, 0, 0],
]  # fmt: skip
ARM = "DEF arm SerialRobot { dhParams [ 0 0 0 0.3, 1.57 0.2 0 0 ] %s }"


def read(text: str, folder: Path) -> ImportedTables:
    return read_x3d(written(text, folder))


def written(text: str, folder: Path) -> Path:
    path = folder / "scene.x3d"
    path.write_text(f"#X3D V3.0 utf8\n{text}\n", encoding="utf-8")
    return path


def errors_in(text: str, folder: Path) -> list[str]:
    path = written(text, folder)
    with pytest.raises(DeclarationError) as caught:
        load_scene(path)
    return [line.removeprefix(f"{path}:") for line in str(caught.value).splitlines()]


def test_fig_7_is_read_as_printed() -> None:
    described = read_x3d(FIG7)
    assert described.tables == {
        "robots": {
            "lwr": {
                "dh_convention": "craig",
                "dh_params": LWR,
                "offsets_to_center_of_joints": [
                    [0, 0, -0.2], [0, 0, 0], [0, 0, -0.2], [0, 0, 0],
                    [0, 0, -0.2], [0, 0, 0], [0, 0, 0.1],
                ],
            }
        },
        "sources": {"udpProto": {"kind": "udp", "structure": "7F7F", "port": 32000}},
        "routes": {"lwr.joint_angles": "udpProto.values0", "lwr.torques": "udpProto.values1"},
    }  # fmt: skip
    files = ", ".join(["base.wrl", *(f"link{k}.wrl" for k in range(1, 8))])
    assert described.warnings == [
        f"missing geometry files {files} in 3dModels/robots/lwr/wrl; the links of lwr are "
        "generated from the DH table"
    ]
    assert described.lines["robots.lwr.dh_params"] == 10
    assert described.lines["routes.lwr.torques"] == 22


def test_packets_move_the_robot_of_fig_7_through_its_routes() -> None:
    scene = load_scene(FIG7)
    scene.sources["udpProto"]["port"] = 0  # so that tests can run in parallel
    values = np.random.default_rng(3).uniform(-1.5, 1.5, 14)
    with Mirror(scene) as mirror, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        source = mirror.sources["udpProto"]
        assert isinstance(source, UdpReceiver)
        sender.sendto(struct.pack("<14d", *values), ("127.0.0.1", source.port))
        assert until(mirror.advance)
        frames = mirror.world.frames
        at = mirror.data.site_xpos[frames.site[frames.names.index("lwr/flange")]]
        assert np.allclose(at, _flange(values[:7])[:3, 3], atol=1e-9)
        torques = mirror.data.userdata[mirror.world.slots["lwr.torques"]]
        assert torques.tolist() == values[7:].tolist()


def _flange(q: Array) -> Array:
    """Returns Craig's equation 3.6, row by row, written out: alpha, a, theta, d."""
    T = np.eye(4)
    for (alpha, a, theta, d), angle in zip(LWR, q, strict=True):
        ca, sa = np.cos(alpha), np.sin(alpha)
        c, s = np.cos(theta + angle), np.sin(theta + angle)
        T = T @ [
            [c, -s, 0, a],
            [s * ca, c * ca, -sa, -d * sa],
            [s * sa, c * sa, ca, d * ca],
            [0, 0, 0, 1],
        ]
    return np.asarray(T)


FULL = """
PROTO SerialRobot [
  field SFString name "robot"
  field MFVec4f dhParams [0,0,0,0]
  exposedField SFMatrix4f baseFrame 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1
  field MFVec3f offsetsToCenterOfJoints [0,0,0]
  exposedField MFFloat jointAngles [0]
  field SFFloat axesSize 0.3
  eventIn MFFloat torques
] { Group {} }
EXTERNPROTO Packets [] "PROTO_udpReceiver.wrl"
EXTERNPROTO Memory [ field SFString block ] "all.wrl#ShmReader"
DEF left-arm SerialRobot {
  name "left arm of the robot"
  dhParams [0 0 0 .3, 1.57 0 0 0]
  baseFrame 0 1 0 0  -1 0 0 0  0 0 1 0  0.5 0.25 1 1
  flangeFrame [1 0 0 0 0 1 0 0 0 0 1 0 0 0 0.1 1]
  jointAngles [0.1 0.2]
  enableTouchSensor FALSE
  showAxes TRUE axesTransparency .5 showArrows TRUE arrowRadius .2 arrowWidthScale .02
  showBillboards TRUE billboardScale .04
  torqueLimits [ 30 20 ]
  children [ Transform { translation 0 0 .1 children Shape { geometry Sphere { radius .02 } } } ]
}
DEF udp Packets { structure "2F2F1M" udpport 4711 bufferSize 1000 isDouble FALSE columnMajor FALSE
  onlyLatestPacket FALSE scale 0.5 debuglevel 5 host "0.0.0.0" }
DEF shm Memory { structure "2F" block "/robot" }
ROUTE udp.values0_changed TO left-arm.set_jointAngles
ROUTE udp.values1 TO left-arm.billboardValues
ROUTE udp.matrices0 TO left-arm.baseFrame
ROUTE udp.receiving TO left-arm.showArrows
ROUTE shm.values0 TO left-arm.torques
"""


def test_every_field_of_fig_3_and_fig_5_is_read(tmp_path: Path) -> None:
    described = read(FULL, tmp_path)
    assert described.warnings == []
    robot = described.tables["robots"]["left-arm"]
    assert robot == {
        "dh_convention": "craig",
        "description": "left arm of the robot",
        "dh_params": [[0, 0, 0, 0.3], [1.57, 0, 0, 0]],
        "base_frame": [[0, -1, 0, 0.5], [1, 0, 0, 0.25], [0, 0, 1, 1], [0, 0, 0, 1]],
        "flange_frame": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.1], [0, 0, 0, 1]],
        "joint_angles": [0.1, 0.2],
        "enable_touch_sensor": False,
        "axes_size": 0.3,  # of the PROTO
        "show_axes": True,
        "axes_transparency": 0.5,
        "show_arrows": True,
        "arrow_radius": 0.2,
        "arrow_width_scale": 0.02,
        "show_billboards": True,
        "billboard_scale": 0.04,
        "torque_limits": [30, 20],
        "children": [
            {"name": "sphere", "shape": "sphere", "size": [0.02],
             "frame": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.1], [0, 0, 0, 1]]},
        ],
    }  # fmt: skip
    assert described.tables["sources"] == {
        "udp": {"kind": "udp", "structure": "2F2F1M", "port": 4711, "buffer_size": 1000,
                "double": False, "column_major": False, "only_latest_packet": False,
                "scale": 0.5, "debug_level": 3, "host": "0.0.0.0"},
        "shm": {"kind": "shm", "structure": "2F", "block": "/robot"},
    }  # fmt: skip
    assert described.tables["routes"] == {
        "left-arm.joint_angles": "udp.values0",
        "left-arm.billboard_values": "udp.values1",
        "left-arm.base_frame": "udp.matrices0",
        "left-arm.show_arrows": "udp.receiving",
        "left-arm.torques": "shm.values0",
    }
    World(load_scene(tmp_path / "scene.x3d"))


SURROUNDINGS = """
WorldInfo { title "A cell" }
Background { skyColor 0 0 1 }
DEF front Viewpoint { position 0 1 4 fieldOfView 0.5 }
Viewpoint { description "from above" position 0 5 0 orientation 1 0 0 -1.5707963 }
DirectionalLight { direction 0 -1 0 intensity 0.5 }
SpotLight { location 1 2 3 direction 0 -1 0 }
PointLight {}
Transform { translation 0 0.5 0 rotation 0 1 0 0.5 scale 2 2 2 children [
  DEF table Shape { geometry Box { size 0.5 0.1 0.25 }
    appearance Appearance { material Material { diffuseColor .5 .25 0 } } }
  Shape { geometry Cylinder { radius 0.1 height 1 } }
] }
Transform { scale 1 2 3 children Shape { geometry Sphere { radius 0.1 } } }
Shape { geometry Cone { bottomRadius 0.1 height 0.2 } }
Shape { geometry IndexedFaceSet { coord Coordinate { point [0 0 0, 1 0 0, 0 0 1] }
  coordIndex [0 1 2] solid FALSE } }
Transform { rotation 1 0 0 -1.57079632679 children DEF arm SerialRobot { dhParams [ 0 0 0 1 ] } }
TimeSensor {} TimeSensor {}
"""


def test_surroundings_become_objects_cameras_and_lights(tmp_path: Path) -> None:
    described = read(SURROUNDINGS, tmp_path)
    tables = described.tables
    assert described.warnings == [
        "y is up in this scene, so the scene is rotated to make z point up",
        "these nodes are not shown: Background (line 4), PointLight (line 9), TimeSensor (line 20)",
    ]
    assert tables["description"] == "A cell" and tables["view"] == {"camera": "front"}
    objects = tables["objects"]
    assert list(objects) == ["table", "cylinder", "sphere", "cone", "indexedfaceset"]
    assert objects["table"]["size"] == [1.0, 0.2, 0.5]
    assert objects["table"]["rgba"] == [0.5, 0.25, 0, 1]
    assert objects["cylinder"]["size"] == [0.2, 2.0]
    assert objects["sphere"] == {
        "shape": "ellipsoid", "size": [0.1, 0.2, 0.3],
        "frame": [[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]],
    }  # fmt: skip
    camera = tables["cameras"]["front"]
    assert camera == {"position": [0, -4, 1], "look_at": [0, 0, 1], "fovy_deg": 28.647889757}
    assert tables["cameras"]["from_above"]["position"] == [0, 0, 5]
    assert tables["lights"]["light"]["direction"] == [0, 0, -1]
    assert tables["lights"]["light2"]["position"] == [1, -3, 2]
    # y is up: the robot's z, along y there, is z here.
    assert "base_frame" not in tables["robots"]["arm"] or np.allclose(
        tables["robots"]["arm"]["base_frame"], np.eye(4), atol=1e-9
    )
    scene = load_scene(tmp_path / "scene.x3d")
    world = World(scene)
    data = world.make_data()
    mujoco.mj_kinematics(world.model, data)
    # The axis of the cylinder, y there, is up here; that of MuJoCo's cylinders is z.
    axes = data.geom("cylinder").xmat.reshape(3, 3)
    assert np.allclose(np.abs(axes[:, 2]), [0, 0, 1])
    assert np.allclose(data.geom("table").xpos, [0, 0, 0.5])
    for name in ("cone", "indexedfaceset"):
        assert world.model.body(f"{name}/").id > 0


def test_z_is_up_if_robots_stand_along_z(tmp_path: Path) -> None:
    view = "Viewpoint { position 4 0 1 orientation 0.57735 0.57735 0.57735 2.0944 }"
    for text in (ARM % "", f"{view} {ARM % ''}"):
        described = read(text, tmp_path)
        assert described.warnings == []
        assert "base_frame" not in described.tables["robots"]["arm"]
    camera = described.tables["cameras"]["view"]
    assert np.allclose(camera["position"], [4, 0, 1])
    assert np.allclose(camera["look_at"], [0, 0, 1], atol=1e-3)
    rolled = view.replace("2.0944", "2.6")
    (warning,) = read(f"{rolled} {ARM % ''}", tmp_path).warnings
    assert warning.startswith("Viewpoint 'view' (line 2) has a roll of ")


def test_only_links_without_a_file_are_generated_from_the_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    red = "appearance Appearance { material Material { diffuseColor 1 0 0 } }"
    head = "#VRML V2.0 utf8\n"
    (tmp_path / "link1.wrl").write_text(
        f"{head}Shape {{ {red} geometry Box {{ size .1 .2 .3 }} }} "
        "Transform { translation 0 0 0.3 children Shape { geometry Sphere { radius 0.05 } } }"
    )
    (tmp_path / "link2.wrl").write_text(f"{head}Shape {{\n geometry Box {{ size 1 1 }} }}")
    described = read(ARM % 'filenames [ "base.wrl" "link1.wrl" "link2.wrl" ]', tmp_path)
    assert described.warnings == [
        "link2.wrl of arm is replaced by a link generated from the DH table: "
        f"{tmp_path / 'link2.wrl'}:3: Box.size: "
        "found 2 numbers; expected 3 numbers",
        "missing geometry files base.wrl; the links of arm are generated from the DH table",
    ]
    assert described.tables["robots"]["arm"]["filenames"] == [
        {"shape": "generated"}, "link1.wrl", {"shape": "generated"},
    ]  # fmt: skip
    model = World(load_scene(tmp_path / "scene.x3d")).model
    kinds = [[], [], []]
    for geom in range(model.ngeom):
        name = model.body(model.geom_bodyid[geom]).name
        link = {"arm/": 0, "arm/link1": 1, "arm/link2": 2}.get(name)
        if link is not None:
            kinds[link].append(mujoco.mjtGeom(model.geom_type[geom]).name[7:].lower())
    assert kinds[1] == ["mesh", "mesh"]  # one for each color
    assert "mesh" not in kinds[0] + kinds[2] and kinds[0] and kinds[2]
    colors = model.geom_rgba[model.geom_type == mujoco.mjtGeom.mjGEOM_MESH]
    assert colors[0].tolist() == [1, 0, 0, 1]
    sizes = model.geom_rbound[model.geom_type == mujoco.mjtGeom.mjGEOM_MESH]
    assert sizes[0] == pytest.approx(np.linalg.norm([0.05, 0.1, 0.15]), rel=1e-6)


GRIPPER = "DEF gripper SerialRobot { dhParams [ 0 0 0 0.1 ] }"


@pytest.mark.parametrize(
    "text",
    [
        ARM % f"children {GRIPPER}",
        f"{ARM % ''} {GRIPPER} ROUTE arm.fwdKinFromBaseToFlange TO gripper.baseFrame",
        f"{ARM % ''} DEF tool MatrixTransform {{ children {GRIPPER} }}"
        " ROUTE arm.fwdKinFromBaseToFlange TO tool.set_matrix",
    ],
)
def test_tools_of_all_kinds_in_the_paper_are_at_the_flange(text: str, tmp_path: Path) -> None:
    described = read(text, tmp_path)
    assert described.warnings == []
    assert described.tables["robots"]["gripper"]["mount"] == "arm/flange"
    assert "base_frame" not in described.tables["robots"]["gripper"]
    World(load_scene(tmp_path / "scene.x3d"))


def test_matrices_with_the_translation_in_the_fourth_column_are_reported(tmp_path: Path) -> None:
    described = read(ARM % "baseFrame 0 -1 0 5  1 0 0 6  0 0 1 7  0 0 0 1", tmp_path)
    (warning,) = described.warnings
    assert warning == (
        "arm.baseFrame (line 2) has the translation in the fourth column instead of the "
        "fourth row, and is transposed"
    )
    expected = [[0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]]
    assert described.tables["robots"]["arm"]["base_frame"] == expected


@pytest.mark.parametrize(
    ("text", "messages"),
    [
        (ARM % "showAxis TRUE",
         ["2: arm.showAxis: unknown field; did you mean 'showAxes'?"]),
        (ARM % "jointAngles [1 2 3]",
         ["2: robots.arm.joint_angles: found 3 entries; expected 2, one per row"]),
        (ARM % "torques [1 2]",
         ["2: arm.torques is an event without a value; expected a ROUTE TO arm.torques"]),
        (ARM % "baseFrame 2 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1",
         ["2: arm.baseFrame: found 2 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1; expected a rotation matrix, "
          "with translation and 1 in the fourth row"]),
        (f"{ARM % ''}\nROUTE udp.values0 TO arm.jointAngles",
         ["3: ROUTE udp.values0 TO arm.jointAngles: no DEF 'udp'; available: arm"]),
        (f"{ARM % ''}\nDEF udp UdpReceiver {{ structure \"2F\" }}\n"
         "ROUTE udp.values0 TO arm.jointAngels\nROUTE udp.values7 TO arm.torques",
         ["4: ROUTE udp.values0 TO arm.jointAngels: no input 'jointAngels'; did you mean "
          "'jointAngles'?"]),
        (f"{ARM % ''}\nDEF udp UdpReceiver {{ structure \"2F\" }}\n"
         "ROUTE udp.values7 TO arm.torques",
         ["4: routes.arm.torques: no event 'values7' of udp; did you mean 'values0'?"]),
        ("DEF udp UdpReceiver {\n structure \"7Z\"\n}",
         ["3: sources.udp.structure: structure '7Z', character 2: found 'Z', expected"]),
        (f"{ARM % ''} USE arm",
         ["2: arm is used twice; expected a second SerialRobot node instead of USE"]),
        (f"Transform {{ scale 2 2 2 children {ARM % ''} }}",
         ["2: arm.baseFrame is in a Transform with a scale, but robots cannot be scaled"]),
        (ARM % "directory \"http://x.org/lwr\" filenames [ \"a.wrl\" ]",
         ["2: arm.directory: found 'http://x.org/lwr'; expected a folder"]),
        ("DEF shm ShmReader { structure \"2F\" }", ["2: sources.shm.block is required"]),
    ],
)  # fmt: skip
def test_errors_are_reported_with_lines(text: str, messages: list[str], tmp_path: Path) -> None:
    found = errors_in(text, tmp_path)
    assert len(found) == len(messages)
    for line, message in zip(found, messages, strict=True):
        assert line.startswith(message)


def test_commands_accept_an_x3d_scene(
    capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    with pytest.raises(SystemExit) as done:
        main(["check", str(FIG7)])
    assert done.value.code == 0
    out = capsys.readouterr().out
    assert "robot   lwr: 7 joints, craig DH, shapes generated from its DH table" in out
    assert "route   udpProto.values1 -> lwr.torques" in out
    assert [record.levelno for record in caplog.records] == [logging.WARNING]  # one, with all files
    with pytest.raises(SystemExit) as done:
        main(["check", str(FIG7.with_name("fig8.x3d"))])
    assert done.value.code == 2
    assert "fig8.x3d: no such file; did you mean 'fig7.x3d'?" in capsys.readouterr().err
    xml = tmp_path / "scene.x3d"
    xml.write_text('<?xml version="1.0"?>\n<X3D/>')
    with pytest.raises(SystemExit):
        main(["check", str(xml)])
    assert "is X3D in the XML encoding; expected the first line `#X3D V" in capsys.readouterr().err


def test_recording_of_an_x3d_scene_contains_its_robots(tmp_path: Path) -> None:
    scene = load_scene(FIG7)
    scene.sources["udpProto"]["port"] = 0
    path = tmp_path / "run.mcap"
    packets = np.random.default_rng(1).uniform(-1, 1, (5, 14))
    with Mirror(scene) as mirror, record_sources(mirror.sources, path, scene=scene):
        source = mirror.sources["udpProto"]
        assert isinstance(source, UdpReceiver)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for count, packet in enumerate(packets, 1):
                sender.sendto(struct.pack("<14d", *packet), ("127.0.0.1", source.port))
                assert until(lambda count=count: source.counters.received == count)
    run = read_run(path)
    assert list(run.robots) == ["lwr"]
    assert np.allclose(run.robots["lwr"].dh_params, LWR)
