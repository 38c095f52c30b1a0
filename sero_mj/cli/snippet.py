"""Example code for a control loop, or a controller of a simulated robot: `new --snippet`."""

from __future__ import annotations

import re
from importlib import resources
from pathlib import PurePath
from typing import TYPE_CHECKING

from ..base.errors import UnknownName

if TYPE_CHECKING:
    from collections.abc import Mapping


_SCENE = """\
# Shows what the lines of `sero-mj new --snippet {name}` send: angles (rad), measured and commanded
# torques (Nm) of {n} joints.
[robots.{robot}]
model = "{model}"
show_arrows = true
show_billboards = true

[sources.udp]
kind = "udp"
host = "{host}"
port = {port}
structure = "count:1I time:1F angles:{n}F torques:{n}F commanded:{n}F"
sequence = "count"
time = "time"

[routes]
"{robot}.joint_angles" = "udp.angles"
"{robot}.torques" = "udp.torques"
"{robot}.commanded_torques" = "udp.commanded{more}"
"""
_SCENARIO = """\
# Runs the controller of `sero-mj new --snippet {name}`: it follows a sine, and does not overshoot.
[robots.{robot}]
model = "{model}"
show_arrows = true

[controllers.{robot}]
{controller}

[targets.{robot}]
kind = "sine"
amplitude_deg = 5
frequency = 0.5
ramp = 1.0

[run]
duration = 3.0

[expect.follows]
robot = "{robot}"
measure = "position_error"
below = 0.05
"""
_CONTROLLERS = {
    "controller-c": 'kind = "library"\nfile = "controller.so"',
    "controller-cpp": 'kind = "library"\nfile = "controller.so"',
    "controller-rust": 'kind = "library"\nfile = "controller.so"',
    "controller-udp-c": 'kind = "udp"\ncommand = ["./controller", "{port}"]',
    "controller-udp-python": 'kind = "udp"\ncommand = ["python3", "controller.py", "{port}"]',
}
_HEADER = '#include "sero_mj_controller.h"\n'
_MORE = {  # what is added to commanded torques; those of Franka are without gravity
    name: " + {robot}.gravity_torques" for name in ("franka-cpp", "franka-python")
}
_ROBOTS = {"franka-cpp": "fr3", "franka-python": "fr3", "lcm": "iiwa14", "ur": "ur5e"}
_HOST, _PORT = re.compile(r"127\.0\.0\.1"), re.compile(r"\b32000\b")
_JOINTS = re.compile(r"(JOINTS\b[^\d\n]{1,9})\d+")


def snippets() -> Mapping[str, str]:
    """Returns the texts of all snippets by name."""
    folder = resources.files(__package__) / "snippets"
    files = sorted(folder.iterdir(), key=lambda file: file.name)
    return {PurePath(each.name).stem: each.read_text("utf-8") for each in files if each.is_file()}


def snippet_text(name: str, robot: str | None, host: str, port: int, *, is_scene: bool) -> str:
    """Returns a snippet, or the scene or scenario for it; raises UnknownName.

    Args:
        name: name of the snippet.
        robot: robot of the scene: a file or a shipped name. None selects that of the snippet.
        host: address of sero-mj, as seen by the robot's computer.
        port: UDP port of the packets.
        is_scene: whether to return the scene.
    """
    from ..load import load_robot

    known = snippets()
    if name not in known:
        raise UnknownName("snippet", name, known)
    model = robot or _ROBOTS.get(name, "lwr")
    loaded = load_robot(model)
    n = loaded.coupled.k  # the other joints follow
    names = {"name": name, "robot": loaded.name, "model": model}
    if is_scene and name in _CONTROLLERS:
        return _SCENARIO.format(controller=_CONTROLLERS[name], **names)
    if is_scene:
        more = _MORE.get(name, "").format(robot=loaded.name)
        return _SCENE.format(n=n, more=more, host=host, port=port, **names)
    if _HEADER in known[name]:
        from ..simulate.external_control.library import HEADER

        return known[name].replace(_HEADER, HEADER.read_text(encoding="utf-8"))
    text = _JOINTS.sub(rf"\g<1>{n}", known[name])
    return _PORT.sub(str(port), _HOST.sub(host, text))
