"""Snippets for control loops are compiled and run, and their data moves the scene."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run_command
from conftest import free_udp_port
from newton_euler import inverse_dynamics
from polling import until

from sero_mj import Mirror, load_scene
from sero_mj.cli.new import snippets
from sero_mj.load import load_robot
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics

N = 7
ANGLES, TORQUES, COMMANDED = 0.1 * np.arange(N), 2.0 * np.arange(N), 3.0 + np.arange(N)
TIME = 1.5e9
# Array literals such as C's `double angles[7] = {...}`, matched by the text around the numbers.
_NAMES = {"angles": ANGLES, "torques": TORQUES, "commanded": COMMANDED}


def numbers(values: np.ndarray) -> str:
    return ", ".join(f"{value:.17f}" for value in values)


def compiled(folder: Path, name: str, text: str, compiler: str, *options: str) -> list[str]:
    if shutil.which(compiler) is None:
        pytest.skip(f"needs the compiler {compiler}")
    (folder / name).write_text(text)
    program = folder / "sender"
    subprocess.run([compiler, *options, name, "-o", str(program)], cwd=folder, check=True)
    return [str(program)]


def c(folder: Path, text: str) -> list[str]:
    arrays = "".join(f"double {name}[] = {{{numbers(v)}}};" for name, v in _NAMES.items())
    call = "sero_send(angles, torques, commanded)"
    main = f"int main(void) {{ {arrays} for (int k = 0; k < 5; k++) {call}; return 0; }}"
    return compiled(folder, "sender.c", f"{text}\n{main}\n", "gcc", "-Wall", "-Wextra", "-Werror")


def franka_cpp(folder: Path, text: str) -> list[str]:
    (folder / "franka").mkdir()
    (folder / "franka" / "robot_state.h").write_text(  # these fields are libfranka's, too
        "#pragma once\n#include <array>\nnamespace franka { struct RobotState {"
        " std::array<double, 7> q, tau_J, tau_J_d; }; }\n"
    )
    state = "{" + ", ".join(f"{{{numbers(values)}}}" for values in _NAMES.values()) + "}"
    main = (
        f"int main() {{ franka::RobotState state{state};"
        " for (int k = 0; k < 5; k++) sero.send(state); }"
    )
    options = ("-std=c++17", "-Wall", "-Werror", "-Wno-missing-braces", "-I.")
    return compiled(folder, "sender.cpp", f"{text}\n{main}\n", "g++", *options)


def rust(folder: Path, text: str) -> list[str]:
    arrays = ", ".join(f"&[{numbers(values)}]" for values in _NAMES.values())
    main = (
        "fn main() { let mut sero = SeroMj::new().unwrap();"
        f" for _ in 0..5 {{ sero.send({TIME:.1f}, {arrays}); }} }}"
    )
    return compiled(folder, "sender.rs", f"{text}\n{main}\n", "rustc", "-D", "warnings")


def simulink(folder: Path, text: str) -> list[str]:
    """Runs the snippet in Octave; Python sends its return value."""
    if shutil.which("octave-cli") is None:
        pytest.skip("needs the interpreter octave-cli")
    (folder / "sero_packet.m").write_text(text)
    arrays = ", ".join(f"[{numbers(values)}]" for values in _NAMES.values())
    code = f"for k = 1:5, fwrite(stdout, sero_packet(k, {TIME}, {arrays}), 'uint8'); end"
    packets = subprocess.run(
        ["octave-cli", "--eval", code], cwd=folder, check=True, capture_output=True
    ).stdout
    port = int(text.rpartition(", ")[2].strip().rstrip(")"))
    (folder / "send.py").write_text(
        f"import socket\npackets = {packets!r}\nsize = len(packets) // 5\n"
        "to = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)\n"
        "for k in range(5):\n"
        f"    to.sendto(packets[size * k : size * (k + 1)], ('127.0.0.1', {port}))\n"
    )
    return [sys.executable, "send.py"]


def python(**modules: str) -> Callable[[Path, str], list[str]]:
    """Runs a Python snippet with fake robot modules, which end it."""

    def build(folder: Path, text: str) -> list[str]:
        values = "".join(f"{name} = {list(map(float, v))}\n" for name, v in _NAMES.items())
        (folder / "values.py").write_text(f"{values}time = {TIME}\n")
        for name, code in modules.items():
            (folder / f"{name}.py").write_text(f"import sys\nfrom values import *\n{code}")
        (folder / "sender.py").write_text(text)
        return [sys.executable, "sender.py", "10.0.0.1"]

    return build


_COUNTED = """
class Robot:
    def __init__(self, address, rate=0.0):
        assert address == "10.0.0.1"
        self.left = 5
    def counted(self):
        self.left -= 1
        if self.left < 0:
            sys.exit()
"""
_FRANKA = f"""{_COUNTED}
    q, tau_J, tau_J_d = angles, torques, commanded
    def read_once(self):
        self.counted()
        return self
"""
_UR = f"""{_COUNTED}
    def getActualQ(self):
        self.counted()
        return angles
    def getTargetMoment(self):
        return commanded
    def getActualCurrentAsTorque(self):
        return torques
RTDEReceiveInterface = Robot
"""
_LCM = """
class LCM:
    def subscribe(self, channel, handler):
        assert channel == "IIWA_STATUS"
        self.handler, self.left = handler, 5
    def handle(self):
        self.left -= 1
        if self.left < 0:
            sys.exit()
        self.handler("IIWA_STATUS", b"status")
"""
_DRAKE = """
class lcmt_iiwa_status:  # with KUKA's sign of torques, which the driver passes on
    joint_position_measured, utime = angles, 1e6 * time
    joint_torque_measured = [-torque for torque in torques]
    joint_torque_commanded = [-torque for torque in commanded]
    def decode(data):
        assert data == b"status"
        return lcmt_iiwa_status
"""
_ROS = """
from types import ModuleType, SimpleNamespace
class JointState: ...
class Node:
    def __init__(self, name): ...
    def create_subscription(self, kind, topic, call, qos):
        assert (kind, topic) == (JointState, "joint_states")
        self.call = call
def init(): ...
def spin(node):
    stamp = SimpleNamespace(sec=int(time), nanosec=0)
    # In the order of the first message; what others have comes in between.
    names = [f"joint{k}" for k in range(7)]
    for turn in range(5):
        order = range(7) if turn == 0 else range(6, -1, -1)
        node.call(SimpleNamespace(
            header=SimpleNamespace(stamp=stamp), name=[names[k] for k in order],
            position=[angles[k] for k in order], effort=[torques[k] for k in order]))
        node.call(SimpleNamespace(
            header=SimpleNamespace(stamp=stamp), name=["wheel"], position=[1.0], effort=[]))
for name, has in {"rclpy.node": {"Node": Node}, "rclpy.qos": {"qos_profile_sensor_data": 0},
                  "sensor_msgs": {}, "sensor_msgs.msg": {"JointState": JointState}}.items():
    sys.modules[name] = ModuleType(name)
    vars(sys.modules[name]).update(has)
"""
BUILD: dict[str, Callable[[Path, str], list[str]]] = {
    "c": c,
    "franka-cpp": franka_cpp,
    "franka-python": python(pylibfranka=_FRANKA),
    "lcm": python(lcm=_LCM, drake=_DRAKE),
    "ros2": python(rclpy=_ROS),
    "rust": rust,
    "simulink": simulink,
    "ur": python(rtde_receive=_UR),
}


OF_EXTENSIONS = ("franka-cpp", "franka-python", "ros2", "ur")


def cases(*values: tuple[str, ...]) -> list[Any]:
    """Returns cases whose first value is a snippet, which an extension may provide."""
    marks = {name: [pytest.mark.extensions] for name in OF_EXTENSIONS}
    return [pytest.param(*each, marks=marks.get(each[0], [])) for each in values]


@pytest.mark.extensions
def test_all_snippets_are_tested() -> None:
    controllers = {name for name in snippets() if name.startswith("controller-")}
    # These are tested by test_external_control.
    assert BUILD.keys() == snippets().keys() - controllers


@pytest.mark.parametrize("name", cases(*((name,) for name in BUILD)))
def test_scene_shows_the_data_that_a_snippet_sends(name: str, tmp_path: Path) -> None:
    port, words = str(free_udp_port()), ["new", "--snippet", name, "--robot", "lwr"]
    status, text = run_command([*words, "--port", port], tmp_path, os.environ)
    assert status == 0
    sender = BUILD[name](tmp_path, text)
    status, scene = run_command([*words, "--scene", "--port", port], tmp_path, os.environ)
    assert status == 0
    (tmp_path / "scene.toml").write_text(scene)
    with Mirror(load_scene(tmp_path / "scene.toml")) as mirror:
        source = mirror.sources["udp"]
        subprocess.run(sender, cwd=tmp_path, check=True, timeout=30)
        until(lambda: source.counters.received == 5)
        mirror.advance()
        data, slots = mirror.data, mirror.world.slots
        assert data.qpos == pytest.approx(ANGLES)
        assert data.userdata[slots["lwr.torques"]] == pytest.approx(TORQUES)
        commanded = np.full(N, np.nan) if name == "ros2" else COMMANDED
        if name.startswith("franka"):  # commands without gravity
            robot = load_robot("lwr")
            commanded = COMMANDED + inverse_dynamics(robot, robot_dynamics(robot), ANGLES)
        found = data.userdata[slots["lwr.commanded_torques"]]
        assert found == pytest.approx(commanded, abs=1e-6, nan_ok=True)
        counters = source.counters
        assert (counters.malformed, counters.wrong_size, counters.lost) == (0, 0, 0)


def test_robot_sets_the_number_of_joints_and_unknown_snippets_are_rejected(tmp_path: Path) -> None:
    status, text = run_command(
        ["new", "--snippet", "c", "--robot", "hit_finger", "--host", "10.1.2.3"],
        tmp_path,
        os.environ,
    )
    assert status == 0 and '#define SERO_HOST "10.1.2.3"' in text
    assert "#define SERO_JOINTS 3\n" in text  # the last of four is coupled
    status, output = run_command(["new", "--snippet", "simulnik"], tmp_path, os.environ)
    assert status == 2 and output == "sero-mj: no snippet 'simulnik'; did you mean 'simulink'?\n"


@pytest.mark.parametrize("standard", ["c11", "c17", "gnu99", "gnu11"])
def test_c_compiles_in_any_standard_and_beside_user_macros(standard: str, tmp_path: Path) -> None:
    mine = "\n".join(f"#define {name} (mine)" for name in ("JOINTS", "HOST", "PORT"))
    options = [f"-std={standard}", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wno-nonnull"]
    for call in ("", "sero_send(0, 0, 0); "):  # a file may include it without calling it
        text = f"{mine}\n{snippets()['c'].text}\nint main(void) {{ {call}return 0; }}\n"
        compiled(tmp_path, "sender.c", text, "gcc", *options)


def test_controllers_in_c_compile_in_strict_c_without_user_names(tmp_path: Path) -> None:
    options = ["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    for name, more in (("controller-c", ["-shared", "-fPIC"]), ("controller-udp-c", [])):
        status, text = run_command(["new", "--snippet", name], tmp_path, os.environ)
        assert status == 0
        compiled(tmp_path, "controller.c", text, "gcc", *options, *more)
        named = re.findall(r"^(?:#define|struct) (\w+)", text, re.MULTILINE)
        assert named and all(each.lower().startswith("sero_") for each in named)


@pytest.mark.parametrize(
    ("name", "robot"),
    cases(("ur", "ur5e"), ("franka-cpp", "fr3"), ("lcm", "iiwa14"), ("c", "lwr")),
)
def test_snippet_uses_the_robot_it_is_made_for(name: str, robot: str, tmp_path: Path) -> None:
    status, text = run_command(["new", "--snippet", name, "--scene"], tmp_path, os.environ)
    assert status == 0
    (tmp_path / "scene.toml").write_text(text)
    ((found, of),) = load_scene(tmp_path / "scene.toml").robots.items()
    assert found == robot
    status, text = run_command(["new", "--snippet", name], tmp_path, os.environ)
    assert status == 0 and re.search(rf"JOINTS\b[^\d\n]{{1,9}}{of.n}\b", text)
