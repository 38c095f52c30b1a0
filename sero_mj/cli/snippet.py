"""`sero-mj snippet`: lines for a user's own control loop, or a controller for a simulated robot."""

from __future__ import annotations

import re
from importlib import resources
from pathlib import PurePath
from typing import TYPE_CHECKING, Annotated

from ..base.errors import UnknownName
from ..base.options import Option, Options, Port, positional
from .arguments import command

if TYPE_CHECKING:
    from collections.abc import Mapping

_EPILOG = """\
examples:
  sero-mj snippet franka-cpp > sero_mj.hpp               what a libfranka loop includes
  sero-mj snippet franka-cpp --scene > franka.toml       the scene that shows what it sends
  sero-mj snippet c --robot my_arm/robot.toml --host 192.168.0.7 --port 32001

  sero-mj snippet controller-c > controller.c            a controller for a simulated robot
  sero-mj snippet controller-c --scene > controller.toml

Every packet has a count, a time (s), and angles (rad), measured and commanded torques (Nm) of all
joints, as little-endian float64: the count tells lost packets, the time jitter. NaN is no data.
"""
_SCENE = """\
# Shows what the lines of `sero-mj snippet {name}` send: angles (rad), measured and commanded
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
# Runs the controller of `sero-mj snippet {name}`: it follows a sine, and does not overshoot.
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
ORDER = 33  # in the help of `sero-mj`


class SnippetOptions(Options):
    """Print lines for your control loop that send what a scene here takes, or a controller.

    Attributes:
        name: franka-cpp, franka-python, ur, ros2, lcm, simulink, c or rust; controllers for
            simulated robots are controller-c, controller-cpp, controller-rust (libraries),
            controller-udp-c and controller-udp-python (programs).
        robot: that the scene shows: a file, or a shipped name (default: that of the snippet).
        host: where sero-mj runs, as the robot's computer knows it.
        port: of the packets.
        scene: print the scene instead.
    """

    name: Annotated[str, positional("NAME")]
    robot: Annotated[str | None, Option("ROBOT")] = None
    host: Annotated[str, Option("HOST")] = "127.0.0.1"
    port: Port = 32000
    scene: bool = False


def snippets() -> Mapping[str, str]:
    """Returns the texts of all snippets by name."""
    folder = resources.files(__package__) / "snippets"
    files = sorted(folder.iterdir(), key=lambda file: file.name)
    return {PurePath(each.name).stem: each.read_text("utf-8") for each in files if each.is_file()}


def run(options: SnippetOptions) -> int:
    """Prints; returns 0."""
    from ..load import load_robot

    known = snippets()
    if options.name not in known:
        raise UnknownName("snippet", options.name, known)
    model = options.robot or _ROBOTS.get(options.name, "lwr")
    robot = load_robot(model)
    n = robot.coupled.k  # others follow
    if options.scene and options.name in _CONTROLLERS:
        controller = _CONTROLLERS[options.name]
        names = {"name": options.name, "robot": robot.name, "model": model}
        print(_SCENARIO.format(controller=controller, **names), end="")
        return 0
    if options.scene:
        more = _MORE.get(options.name, "").format(robot=robot.name)
        print(
            _SCENE.format(
                name=options.name, robot=robot.name, model=model, n=n, more=more,
                host=options.host, port=options.port,
            ),
            end="",
        )  # fmt: skip
        return 0
    if _HEADER in known[options.name]:
        from ..simulate.external_control.library import HEADER

        print(known[options.name].replace(_HEADER, HEADER.read_text(encoding="utf-8")), end="")
        return 0
    text = _JOINTS.sub(rf"\g<1>{n}", known[options.name])
    print(_PORT.sub(str(options.port), _HOST.sub(options.host, text)), end="")
    return 0


add_to = command("snippet", run, SnippetOptions, _EPILOG)
