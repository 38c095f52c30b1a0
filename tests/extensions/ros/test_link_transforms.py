"""Robots moved by transforms and odometry of ROS, which a walk through their URDF has computed."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from ros_tools import STORE, encoded, joint_state, odometry, pose_stamped, transforms, write_bag
from test_cli import run
from test_urdf import GRIPPER, poses_in_xml

from sero_mj import Mirror, load_scene
from sero_mj.base.frames import Array, frame, inverse, rotation_about, rotation_from_rpy
from sero_mj.cli.arguments import replay_instead
from sero_mj.data.drive.wiring import wired_source
from sero_mj.extensions.ros.joined_packets import FRAMES, JOINT_STATES, ODOMETRY, POSE
from sero_mj.extensions.ros.ros_source import Listener, RosSource

ARM = GRIPPER.replace("turn.table", "turn").replace("finger a", "finger-a")
STEP = 10**7  # ns between messages
COUNT = 8


def edges(text: str, values: dict[str, float], kinds: tuple[str, ...]) -> list[Any]:
    """What robot_state_publisher sends of the joints of these kinds."""
    poses = poses_in_xml(text, values)
    found = []
    for joint in ElementTree.fromstring(text).findall("joint"):
        ends = [joint.find(tag).get("link") for tag in ("parent", "child")]  # type: ignore
        if joint.get("type") in kinds:
            found.append((*ends, inverse(poses[ends[0]]) @ poses[ends[1]]))
    return found


MOVING = ("revolute", "continuous", "prismatic")


def values_at(t: float) -> dict[str, float]:
    """Of all joints, in the file's names; the continuous one turns more than once."""
    finger = 0.02 + 0.01 * np.sin(t)
    return {
        "turn": 3.0 * t, "slide": 0.2 + 0.1 * np.sin(t), "finger-a": finger,
        "finger-b": 0.25 - 2.0 * finger,
    }  # fmt: skip


def platform(t: float) -> Array:
    return frame(rotation_about(2, 0.5 * t), [t, -2.0 * t, 0.1])


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("robot") / "arm.urdf"
    path.write_text(ARM)
    return path


def heard(robot: Path, routes: dict[str, str], **fields: Any) -> tuple[Listener, list[str]]:
    """Returns the listener of a source that moves the robot, and its list of warnings."""
    scene = load_scene(robot)
    scene.sources = {"ros": {"kind": "ros2", "domain": 1, **fields}}
    scene.routes = {f"arm.{key}": f"ros.{event}" for key, event in routes.items()}
    source = wired_source(scene, "ros", scene.sources["ros"])
    assert isinstance(source, RosSource)
    source.reset()
    listener, said = Listener(source), list[str]()
    listener._joined = source.joined(said.append)
    return listener, said


def latest(listener: Listener) -> dict[str, Array]:
    packet = listener._source.latest()
    assert packet is not None
    return dict(packet.values)


def as_robot_state_publisher(t: float) -> list[Any]:
    return [*edges(ARM, values_at(t), MOVING), ("odom", "base_link", platform(t))]


def all_in_odom(t: float) -> list[Any]:
    poses = poses_in_xml(ARM, values_at(t))
    return [("odom", link, platform(t) @ T) for link, T in poses.items()]


def with_a_prefix(t: float) -> list[Any]:
    sent = as_robot_state_publisher(t)
    return [(one if one == "odom" else f"left/{one}", f"left/{child}", T) for one, child, T in sent]


@pytest.mark.parametrize("sent", [as_robot_state_publisher, all_in_odom, with_a_prefix])
def test_transforms_of_links_tell_joints_and_base(sent: Any, robot: Path) -> None:
    routes = {"joint_angles": "joint_angles", "base_frame": "base_frame"}
    listener, said = heard(robot, routes, joint_states="tf", odometry="tf")
    for t in np.linspace(0.0, 5.0, 40):
        listener.take([(FRAMES, encoded(transforms(sent(t))), b"")])
    values, expected = latest(listener), values_at(5.0)
    names = ["turn", "slide", "finger-a"]  # the turns of the continuous one are counted
    assert values["joint_angles"].tolist() == pytest.approx([expected[name] for name in names])
    np.testing.assert_allclose(values["base_frame"][0], platform(5.0), atol=1e-12)
    assert said == []


def test_unknown_transforms_leave_the_robot_as_declared(robot: Path) -> None:
    routes = {"joint_angles": "joint_angles", "base_frame": "base_frame"}
    listener, _ = heard(robot, routes, joint_states="tf", odometry="tf", root="map")
    home = load_scene(robot).robots["arm"].home[:3]
    turned = edges(ARM, {"turn": 0.5}, ("continuous",))
    listener.take([(FRAMES, encoded(transforms([*turned, ("odom", "map", np.eye(4))])), b"")])
    values = latest(listener)
    assert values["joint_angles"].tolist() == pytest.approx([0.5, *home[1:]])
    np.testing.assert_array_equal(values["base_frame"][0], np.eye(4))
    on_map = [("map", "foot", platform(1.0)), ("foot", "base_link", platform(0.5))]
    for sent in (on_map, turned):  # packets come with the joints
        listener.take([(FRAMES, encoded(transforms(sent)), b"")])
    assert listener._source.receive_trigger == 2
    np.testing.assert_allclose(latest(listener)["base_frame"][0], platform(1.0) @ platform(0.5))


def test_transforms_of_another_robot_and_cycles_are_reported(robot: Path) -> None:
    listener, said = heard(robot, {"joint_angles": "joint_angles"}, joint_states="tf")
    circle = [("a", "b", np.eye(4)), ("b", "a", np.eye(4)), ("a", "base_link", np.eye(4))]
    listener.take([(FRAMES, encoded(transforms(circle)), b"")])
    wrong = frame(rotation_from_rpy(np.array([1.0, 0, 0])))
    listener.take([(FRAMES, encoded(transforms([("base_link", "upper", wrong)])), b"")])
    assert len(said) == 1 and said[0].startswith("the transform of upper ")
    assert np.isfinite(latest(listener)["joint_angles"]).all()


def test_robot_without_link_frames_is_not_moved_by_transforms(tmp_path: Path) -> None:
    scene = tmp_path / "s.toml"
    scene.write_text('[robots.arm]\nmodel = "lwr"')
    _, said = heard(scene, {"joint_angles": "joint_angles"}, joint_states="tf")
    assert "link_frames" in said[0]


def test_odometry_and_poses_are_poses(tmp_path: Path) -> None:
    """Odometry of another link that is fixed to the base, and its velocity in that link."""
    footprint = (
        '<link name="footprint"/><joint name="up" type="fixed"><parent link="footprint"/>'
        '<child link="base_link"/><origin xyz="0.1 0 0.2" rpy="0 0 0.3"/></joint>'
    )
    robot = tmp_path / "arm.urdf"
    robot.write_text(ARM.replace("  <link", f"{footprint}<link", 1))
    routes = {"base_frame": "base_frame", "joint_angles": "joint_angles", "flange_check": "pose"}
    listener, _ = heard(robot, routes, odometry="/odom", pose="/mocap")
    listener.take([(JOINT_STATES, encoded(joint_state(["turn"], [0.3])), b"")])
    np.testing.assert_array_equal(latest(listener)["base_frame"][0], np.eye(4))
    message = odometry(platform(1.0), "base_link", (0.5, 0.1, 0.0))
    listener.take([(ODOMETRY, encoded(message), b""),
                   (POSE, encoded(pose_stamped(platform(2.0))), b""),
                   (JOINT_STATES, encoded(joint_state(["turn"], [0.4])), b"")])  # fmt: skip
    values = latest(listener)
    up = frame(rotation_about(2, 0.3), [0.1, 0.0, 0.2])
    np.testing.assert_allclose(values["base_frame"][0] @ up, platform(1.0), atol=1e-12)
    assert values["base_velocity"].ravel().tolist() == [0.5, 0.1, 0.0]
    assert values["base_angular_velocity"].ravel().tolist() == [0.1, 0.2, 0.3]
    np.testing.assert_allclose(values["pose"][0], platform(2.0), atol=1e-12)
    broken = odometry(platform(1.0), "base_link")
    broken.pose.pose.orientation.w = 5.0
    listener.take([(ODOMETRY, encoded(broken), b"")])
    assert "unit quaternion" in listener._source.layout.fault


def bag_of(folder: Path, *kinds: str) -> Path:
    """A bag with its robot's description and what else moves it."""
    said = STORE.types["std_msgs/msg/String"](ARM)
    at = [(k * STEP, 0.05 * k) for k in range(COUNT)]
    joints = [name for name in values_at(0.0) if name != "finger-b"]
    every = {
        "tf": [(when, transforms(edges(ARM, values_at(t), MOVING))) for when, t in at],
        "odom_tf": [
            (max(when - 1, 0), transforms([("odom", "base_link", platform(t))])) for when, t in at
        ],
        "odom": [(max(when - 1, 0), odometry(platform(t), "base_link")) for when, t in at],
        "joint_states": [
            (when + 2, joint_state(joints, [values_at(t)[name] for name in joints]))
            for when, t in at
        ],
        "tf_static": [(0, transforms(edges(ARM, values_at(0.0), ("fixed",))))],
    }
    topics: dict[str, Any] = {"/robot_description": [(0, said)]}
    for kind in kinds:
        topics.setdefault(f"/{kind.removeprefix('odom_')}", []).extend(every[kind])
    return write_bag(folder / "drive", topics)


@pytest.mark.parametrize(
    ("kinds", "moves_joints"),
    [
        (("tf", "odom_tf", "tf_static"), True),
        (("tf", "odom"), True),
        (("joint_states", "odom"), True),
        (("joint_states", "odom_tf"), True),
        (("odom",), False),
    ],
)
def test_bag_moves_a_mobile_robot(
    kinds: tuple[str, ...], moves_joints: bool, robot: Path, tmp_path: Path
) -> None:
    path, scene = bag_of(tmp_path, *kinds), load_scene(robot)
    replay_instead(scene, path, None)
    t = 0.05 * (COUNT - 1)
    with Mirror(scene) as mirror:
        mirror.advance((COUNT + 5) * STEP * 1e-9)
        part = mirror.world.robots["arm"]
        found = {
            link: mirror.world.frame(mirror.data, part.link_names[body]) @ T_body_link
            for link, (body, T_body_link) in part.robot.link_poses.items()
        }
    home = dict(zip(values_at(0.0), part.robot.home, strict=True))
    poses = poses_in_xml(ARM, values_at(t) if moves_joints else home)
    for link, T in poses.items():
        np.testing.assert_allclose(found[link], platform(t) @ T, atol=1e-9, err_msg=link)


def test_base_of_a_fixed_robot_is_unchanged(robot: Path, tmp_path: Path) -> None:
    scene = load_scene(robot, {"arm.base_frame": {"xyz": [0, 0, 1]}})
    replay_instead(scene, bag_of(tmp_path, "joint_states", "tf", "tf_static"), None)
    assert "arm.base_frame" not in scene.routes


PLATFORM = """<mujoco><worldbody><body name="platform">
  <joint name="px" type="slide" axis="1 0 0"/><joint name="py" type="slide" axis="0 1 0"/>
  <joint name="pyaw" axis="0 0 1"/><geom size="0.2" mass="9"/>
  <body name="link" pos="0.1 0 0.3"><joint name="arm" axis="0 1 0"/><geom size="0.1"/></body>
</body></worldbody><actuator><motor joint="arm"/>{}</actuator></mujoco>"""


@pytest.mark.parametrize("driven", ["", '<position joint="px"/>'])
@pytest.mark.parametrize("kinds", [("tf",), ("joint_states", "odom"), ("joint_states", "tf")])
def test_platform_of_two_prismatic_and_a_revolute_joint_is_at_its_link(
    driven: str, kinds: tuple[str, ...], tmp_path: Path
) -> None:
    """Whether its joints are the robot's, or its base is planar."""
    robot = tmp_path / "robot.xml"
    robot.write_text(PLATFORM.format(driven))
    at = [(k * STEP, 0.05 * k) for k in range(9)]
    on = frame(position=[0.1, 0.0, 0.3])
    T = on @ frame(rotation_about(1, 0.7))
    every = {
        "joint_states": [(when + 1, joint_state(["arm"], [0.7])) for when, _ in at],
        "odom": [(when, odometry(platform(t), "platform")) for when, t in at],
        "tf": [
            (when, transforms([("odom", "platform", platform(t)), ("platform", "link", T)]))
            for when, t in at
        ],
    }
    path = write_bag(tmp_path / "drive", {f"/{kind}": every[kind] for kind in kinds})
    scene = load_scene(robot)
    (name,) = scene.robots
    replay_instead(scene, path, None)
    with Mirror(scene) as mirror:
        mirror.advance(1.0)
        link = mirror.world.frame(mirror.data, f"{name}/link")
    _, back = scene.robots[name].link_poses["link"]
    np.testing.assert_allclose(link @ back, platform(0.4) @ T, atol=1e-9)


@pytest.mark.parametrize(("kind", "is_described"), [("tf", False), ("odom", False), ("tf", True)])
def test_table_of_a_bag_without_joint_states_has_the_joints_of_its_robot(
    kind: str, is_described: bool, robot: Path, tmp_path: Path, capsys: Any
) -> None:
    at = [0.05 * k for k in range(COUNT)]
    messages = {
        "tf": [(round(t * 1e9), transforms(edges(ARM, values_at(t), MOVING))) for t in at],
        "odom": [(round(t * 1e9), odometry(platform(t), "base")) for t in at],
    }
    topics: dict[str, Any] = {f"/{kind}": messages[kind]}
    if is_described:
        topics["/robot_description"] = [(0, STORE.types["std_msgs/msg/String"](ARM))]
    path, table = write_bag(tmp_path / "drive", topics), tmp_path / "drive.csv"
    if kind == "tf" and not is_described:
        status, said, _ = run(capsys, "export", str(path), str(table))
        assert status == 0 and said.endswith("if --scene names the robot\n")
    of_robot = () if is_described else ("--scene", str(robot))
    status, said, told = run(capsys, "export", str(path), str(table), "--overwrite", *of_robot)
    assert status == 0 and f"{COUNT} rows" in said, told
    columns = np.genfromtxt(table, delimiter=",", names=True, deletechars="")
    if kind == "tf":
        turned = [values_at(t)["turn"] for t in at]
        assert columns["joint_angles[turn]"] == pytest.approx(turned)
    else:
        assert columns["base_frame[0][0][3]"] == pytest.approx(at)


@pytest.mark.thorough
def test_commands_take_bags_with_transforms_only(tmp_path: Path, capsys: Any) -> None:
    path = bag_of(tmp_path, "tf", "odom_tf")
    status, said, told = run(capsys, "check", str(path))
    assert status == 0, told
    assert "tf.joint_angles" in said and "tf.base_frame" in said
    table = tmp_path / "drive.csv"
    assert run(capsys, "export", str(path), str(table))[0] == 0
