"""Importers, controllers, tools and commands of third-party packages, found by entry points."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from commands import UNSET, run_command, run_program
from plugin_tools import PLUGINS, install, register, write_package

from sero_mj.base.plugins import COMMANDS, CONTROLLERS, IMPORTERS, TOOLS

SDF = PLUGINS / "two_links.sdf"


def run(folder: Path, program: str, *arguments: str, code: int = 0) -> str:
    """Returns the output of Python code, or of `sero-mj` if it is empty, with these packages."""
    environment = {key: value for key, value in os.environ.items() if key not in UNSET}
    status, said = (
        run_program(program, folder, environment)
        if program
        else run_command(arguments, folder, environment)
    )
    assert status == code, said
    return said


@pytest.fixture
def sdf(tmp_path: Path) -> Path:
    install(tmp_path, "sdf_importer", IMPORTERS, "sdf", "Sdf")
    (tmp_path / SDF.name).write_bytes(SDF.read_bytes())
    return tmp_path


def test_importer_plugin_loads_a_robot_file(sdf: Path) -> None:
    printed = run(sdf, """
import numpy as np, sero_mj
robot = sero_mj.load_scene("two_links.sdf").robots["two_links"]
print(robot.names, robot.link_names, robot.position_limits.round(3).tolist())
at = robot.kinematics.frames(np.array([0.5, -0.25]), np.eye(4))
print(at[:, :3, 3].round(6).tolist(), at[2, :3, 2].round(6).tolist())
""")  # fmt: skip
    names, positions = printed.splitlines()
    assert names == (
        "['shoulder', 'elbow'] ['foot', 'upper_arm', 'fore_arm'] [[-2.0, 2.0], [-3.142, 3.142]]"
    )
    # The elbow is 0.5 m from the shoulder, which is rotated by 0.5 rad.
    assert positions == (
        "[[0.0, 0.0, 0.0], [0.0, 0.0, 0.4], [0.438791, 0.239713, 0.4]] [-0.479426, 0.877583, 0.0]"
    )


def test_imported_file_is_opened_by_its_suffix_and_used_in_scenes(sdf: Path) -> None:
    (sdf / "scene.toml").write_text(
        '[robots.arm]\nmodel = "two_links.sdf"\njoint_angles = [1, 0]\n'
    )
    assert "arm" in run(sdf, "", "check", "scene.toml")
    assert ": no errors" in run(sdf, "", "check", SDF.name)
    (sdf / "wrong.sdf").write_text("<robot name='x'/>")
    output = run(sdf, "", "check", "wrong.sdf", code=2)
    assert output.endswith("/wrong.sdf is a URDF file; expected a file of the importer 'sdf'\n")


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "is empty; expected a file of the importer 'sdf'"),
        ("<sdf><model>", "cannot be read by Sdf: ParseError: "),
        ("<sdf><model><joint type='revolute'><child>a</child></joint></model></sdf>", "KeyError"),
    ],
)
def test_unreadable_file_of_an_importer_plugin_is_named(sdf: Path, text: str, what: str) -> None:
    (sdf / "broken.sdf").write_text(text)
    output = run(sdf, "", "check", "broken.sdf", code=2)
    assert "broken.sdf " in output and "Traceback" not in output
    assert what in output or "cannot be read by Sdf" in output


def test_error_inside_an_importer_plugin_names_its_line(tmp_path: Path) -> None:
    code = (
        "from sero_mj.robots.importers.importer import Importer\n"
        "class Sdf(Importer):\n"
        "    endings = ('.sdf',)\n"
        "    def read(self, path, packages=None, arguments=None):\n"
        "        return float('x')\n"
    )
    write_package(tmp_path, "faulty", code, IMPORTERS, sdf="Sdf")
    (tmp_path / SDF.name).write_bytes(SDF.read_bytes())
    output = run(tmp_path, "", "check", SDF.name, code=2)
    assert output.endswith(
        "cannot be read by Sdf: ValueError: could not convert string to float: 'x' "
        f"({tmp_path}/faulty.py:5)\n"
    )


def test_import_of_an_unconvertible_format_suggests_a_scene(sdf: Path) -> None:
    output = run(sdf, "", "import", SDF.name, code=2)
    assert f"{SDF.name}: found .sdf; expected .urdf, .xacro, .xml. " in output
    assert f'model = "{SDF.name}" in [robots.NAME]' in output
    output = run(sdf, "", "new", "mine", "--like", SDF.name, code=2)
    assert f'model = "{SDF.name}" in a scene' in output and "sero-mj import" not in output


def test_file_format_is_named_without_its_importer_package(tmp_path: Path) -> None:
    (tmp_path / SDF.name).write_bytes(SDF.read_bytes())
    output = run(tmp_path, "", "check", SDF.name, code=2)
    assert output.startswith(f"sero-mj: {SDF.name} is an SDF file; expected a TOML file")


@pytest.fixture
def pd(tmp_path: Path) -> Path:
    install(tmp_path, "pd_controller", CONTROLLERS, "pd", "PD")
    return tmp_path


SCENARIO = """
[robots.lwr]
model = "lwr"
joint_angles = [0, 0.5, 0, -1.0, 0, 0.6, 0]
[run]
duration = 1.0
[controllers.lwr]
kind = "pd"
bandwidth = {bandwidth}
[targets.lwr]
kind = "step"
amplitude = [0.1, 0, 0, 0, 0, 0, 0]
time = 0.1
"""


def test_controller_plugin_runs_in_scenarios_and_is_declared_like_ours(pd: Path) -> None:
    (pd / "s.toml").write_text(SCENARIO.format(bandwidth=20))
    printed = run(pd, """
import numpy as np
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation
simulation = Simulation(read_scenario("s.toml"))
simulation.advance(simulation.steps)
log = simulation.log
moved = log.of("lwr", "joint_angles")[:, 0]
times = log.times - 0.1
print(np.abs(moved - np.where(times > 0, 0.1 * (1 - (1 + 20*times) * np.exp(-20*times)), 0)).max())
""")  # fmt: skip
    assert float(printed) < 2e-3  # the closed-form oscillator; torques are held for one step
    (pd / "s.toml").write_text(SCENARIO.format(bandwidth=-1))
    output = run(pd, "", "check", "s.toml", code=2)
    assert "controllers.lwr.bandwidth: found -1; expected greater than 0" in output
    assert 'kind = "pd"' in run(pd, "", "list", "--fields", "scenarios")


def test_controller_plugin_without_kind_is_reported(pd: Path) -> None:
    file = pd / "pd_controller.py"
    file.write_text(file.read_text().replace('    kind: Literal["pd"] = "pd"\n', ""))
    (pd / "s.toml").write_text(SCENARIO.format(bandwidth=20))
    output = run(pd, "", "check", "s.toml", code=2)
    assert 'TypeError: PD has no field kind: Literal["pd"] = "pd"' in output


def test_target_motion_plugin_is_followed_and_declared_like_ours(tmp_path: Path) -> None:
    install(tmp_path, "nodding", "sero_mj.target_motions", "nod", "Nod")
    (tmp_path / "nod.toml").write_text("""
[robots.lwr]
model = "lwr"
[run]
duration = 2.5
[controllers.lwr]
kind = "joint_position"
[targets.lwr]
kind = "nod"
amplitude = [0, 0.2, 0, 0, 0, 0.1, 0]
period = 1.0
count = 2
""")
    printed = run(tmp_path, """
import numpy as np
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation
simulation = Simulation(read_scenario("nod.toml"))
simulation.advance(simulation.steps)
log = simulation.log
target = log.of("lwr", "target_angles") - simulation.scenario.scene.robots["lwr"].home
print([float(np.interp(t, log.times, target[:, 1]).round(3)) for t in (0, 0.25, 0.5, 1.5, 2.2)])
print(np.abs(log.of("lwr", "joint_angles") - log.of("lwr", "target_angles")).max() < 0.02)
""")  # fmt: skip
    assert printed.splitlines() == ["[0.0, 0.1, 0.2, 0.2, 0.0]", "True"]
    assert 'kind = "nod"' in run(tmp_path, "", "list", "--fields", "scenarios")


@pytest.mark.thorough
def test_controller_plugin_is_selected_and_tuned_in_a_live_simulation(pd: Path) -> None:
    printed = run(pd, """
import sero_mj
from scripted_widgets import ScriptedWidgets
from shown import Shown
from sero_mj import Mirror
from sero_mj.simulate.endless_run import endless_scene
from sero_mj.simulate.tools.steering import Steering
with Mirror(endless_scene(sero_mj.load_scene("lwr"), "pd")) as mirror:
    steering = Steering(Shown(mirror))
    robot = steering.robots["lwr"]
    print(robot.control, [*robot.controllers])
    steering.goals["lwr"].set_joint(0, robot.goal[0] + 0.3)
    for k in range(100):
        steering.advance(0.02)
        mirror.advance(0.02 * k)
    print(abs(robot.measured[0] - robot.goal[0]) < 1e-3, mirror.sources["simulation"].error)
    steering.build(ScriptedWidgets({"bandwidth": 33.0}))
    print(robot.controller.bandwidth)
    ui = ScriptedWidgets({"bandwidth": 1000.0})
    steering.build(ui)
    ui = ScriptedWidgets()
    steering.build(ui)
    print([text for text in ui.texts() if text.startswith("refused")])
""")  # fmt: skip
    control, there, tuned, refused = printed.splitlines()
    kinds = ["gravity_compensation", "joint_impedance", "cartesian_impedance", "pd"]
    assert control == f"pd {kinds}"
    assert (there, tuned) == ("True None", "33.0")
    assert "found 1000; expected less than or equal to 100" in refused


def test_tool_plugin_handles_keys_and_clicks_draws_and_has_a_panel(tmp_path: Path) -> None:
    install(tmp_path, "distance_tool", TOOLS, "distance", "Distance")
    printed = run(tmp_path, """
import numpy as np
from decor_tools import view_at
from scripted_widgets import ScriptedWidgets
from sero_mj import Mirror, Scene, SerialRobot
from sero_mj.viewer.session.keys import help_columns
from sero_mj.viewer.session.tool import Tools, tool_keys
from shown import Shown
with Mirror(Scene(robots=[SerialRobot.from_model("lwr")])) as mirror:
    mirror.advance(0.0)
    shown = Shown(mirror)
    shown.tools = tools = Tools(shown)
    decor = shown.decor
    tool = tools["distance"]
    decor.add(tool)
    decor.lay_out(mirror.data, view_at())
    before = decor.buffer.count
    helped = [row for column in help_columns(tool_keys()) for row in column]
    print(tool_keys()["g"][:2], any("measure" in words for _, words in helped))
    print(tool.actions()["measure"]())
    at = [tuple(decor.view.project(mirror.data.site_xpos[s])[0])
          for s in mirror.world.joints.centre_site[[2, 5]]]
    print(tool.click(None, at[0]))
    said = tool.click(None, at[1])
    points = [decor.point_at(mirror.data, each) for each in at]
    print(said == f"{1e3 * np.linalg.norm(points[1] - points[0]):.1f} mm")
    decor.lay_out(mirror.data, view_at())
    drawn = decor.buffer.rows[before:decor.buffer.count]
    print(said.encode() in [line for p in decor.panels for t in p.texts for line in t])
    row = next(row for row in decor.buffer.rows[:decor.buffer.count] if row["type"] == 3)
    ends = row["pos"] + np.outer([-1, 1], row["mat"][:, 2]) * row["size"][2]
    print(np.abs(np.sort(ends, 0) - np.sort(points, 0)).max() < 1e-6)
    ui = ScriptedWidgets({"stop measuring": True})
    tool.build(ui)
    print(shown.said[-1], tool.is_on)
""")  # fmt: skip
    assert printed.splitlines() == [
        "('measure', 'measure: click on two points') True",
        "click on the first point",
        "click on the second point",
        "True",
        "True",
        "True",
        "('no longer measures', False) False",
    ]


@pytest.mark.parametrize("part", ["state", "drag", "draw", "actions"])
def test_failing_part_of_a_tool_does_not_stop_the_others(tmp_path: Path, part: str) -> None:
    body = "{'fail': lambda: 1 / 0}" if part == "actions" else "1 / 0"
    code = (
        "from sero_mj.viewer.session.tool import Grab, Tool\n"
        "class Partly(Tool):\n"
        "    keys = {'g': ('fail', 'fails'), 'a': ('fail', 'taken')}\n"
        "    def grab(self, at):\n"
        "        return Grab('grabs')\n"
        f"    {'@property' if part == 'state' else ''}\n"
        f"    def {part}(self, *rest):\n"
        f"        return {body}\n"
    )
    write_package(tmp_path, "partly", code, TOOLS, partly="Partly")
    printed = run(tmp_path, f"""
from decor_tools import view_at
from sero_mj import Mirror, load_scene
from sero_mj.viewer.host.pointer import Dragging
from sero_mj.viewer.session.input import Moved
from sero_mj.viewer.session.tool import DrawnTool, Tools
from shown import Shown
with Mirror(load_scene("lwr")) as mirror:
    shown = Shown(mirror)
    shown.tools = tools = Tools(shown)
    tool = tools["partly"]
    if {part!r} == "state":
        tools["undo"].advance(0.1)
    elif {part!r} == "drag":
        dragging = Dragging(tools, lambda text, is_bad: None)
        dragging.take(Moved("orbit", 0.0, 0.0, pulls_from=(1.0, 1.0)), (1.0, 1.0), (1.0, 1.0), None)
        dragging.advance()
        dragging.release()
    elif {part!r} == "draw":
        shown.decor.add(DrawnTool(tool, tools))
        shown.decor.lay_out(mirror.data, view_at())
        shown.decor.lay_out(mirror.data, view_at())
    else:
        act = tools.call(tool, lambda tool: tool.actions())["fail"]
        tools.call(tool, lambda _: act())
    print("partly" in tools, "jogging" in tools, shown.said)
""")  # fmt: skip
    assert (
        "False True [('the tool partly has failed and is removed: division by zero', True)]"
        in printed
    )


def test_controller_takes_over_the_state_of_its_predecessor(tmp_path: Path) -> None:
    code = (
        "from typing import Literal\n"
        "import numpy as np\n"
        "from sero_mj.simulate.control.controller import ControllerDeclaration\n"
        "class PI(ControllerDeclaration):\n"
        "    kind: Literal['pi'] = 'pi'\n"
        "    gain: float = 1.0\n"
        "    def make(self, model, timestep):\n"
        "        return Law(model)\n"
        "class Law:\n"
        "    def __init__(self, model):\n"
        "        self.model, self.steps = model, 0\n"
        "    def take_over(self, before):\n"
        "        self.steps = before.steps\n"
        "    def torques(self, sensed, target, out):\n"
        "        self.steps += 1\n"
        "        self.model.update(sensed.motor_angles, sensed.motor_velocities)\n"
        "        self.model.gravity(out)\n"
        "class NoKind:\n"
        "    pass\n"
    )
    write_package(tmp_path, "pi", code, CONTROLLERS, pi="PI", other="PI", none="NoKind")
    printed = run(tmp_path, """
import sero_mj
from sero_mj import Mirror
from sero_mj.simulate.endless_run import endless_scene
with Mirror(endless_scene(sero_mj.load_scene("lwr"), "pi")) as mirror:
    mirror.advance(0.0)
    mirror.advance(0.1)
    run = mirror.sources["simulation"].run
    robot = run.live.robots["lwr"]
    (controlled,) = run.controlled
    before = controlled.controller.controller.steps
    robot.change({"gain": 2.0}, str)
    print([*robot.controllers][-1], before, controlled.controller.controller.steps)
""")  # fmt: skip
    assert "\npi 100 100\n" in f"\n{printed}"
    assert "'other' of pi 0.1" in printed and "expected the entry point's name" in printed
    assert "'none' of pi 0.1" in printed and "subclass of ControllerDeclaration" in printed


def test_failing_tool_is_reported_and_removed(tmp_path: Path) -> None:
    code = (
        "from sero_mj.viewer.session.tool import Tool\n"
        "class Broken(Tool):\n"
        "    def advance(self, passed):\n"
        "        raise ZeroDivisionError('a fault')\n"
    )
    write_package(tmp_path, "broken", code, TOOLS, broken="Broken", missing="Missing")
    printed = run(tmp_path, """
from sero_mj import Mirror, load_scene
from sero_mj.viewer.session.tool import Tools
from shown import Shown
with Mirror(load_scene("lwr")) as mirror:
    shown = Shown(mirror)
    tools = Tools(shown)
    print("broken" in tools, "missing" in tools, "jogging" in tools)
    tools.call_all(lambda tool: tool.advance(0.1))
    print("broken" in tools, shown.said)
""")  # fmt: skip
    lines = printed.splitlines()  # including those of the log
    assert "True False True" in lines
    assert lines[-1] == "False [('the tool broken has failed and is removed: a fault', True)]"


def test_action_with_a_duplicate_name_is_reported_and_skipped(tmp_path: Path) -> None:
    code = (
        "from sero_mj.viewer.session.tool import Key, Tool\n"
        "class Gap(Tool):\n"
        "    keys = {'y': Key('copy', 'copy the gap', '')}\n"
        "    def actions(self):\n"
        "        return {'copy': lambda: 'the gap', 'gap_copy': lambda: 'the gap'}\n"
    )
    write_package(tmp_path, "gap", code, TOOLS, gap="Gap")
    printed = run(tmp_path, """
from sero_mj import Mirror, load_scene
from sero_mj.viewer.session.tool import Actions
from sero_mj.viewer.session.tool import Tools
from shown import Shown
with Mirror(load_scene("lwr")) as mirror:
    said = []
    actions = Actions({"copy": lambda: "the host's"}, Tools(Shown(mirror)),
                      lambda *told: said.append(told))
    actions.perform("copy"), actions.perform("gap_copy")
    print(said)
""")  # fmt: skip
    assert "the action copy of the tool gap is ignored: the name is in use" in printed
    assert printed.splitlines()[-1] == "[(\"the host's\", False), ('the gap', False)]"


def test_command_that_cannot_be_added_is_reported_and_skipped(tmp_path: Path) -> None:
    code = "ORDER = 5\ndef add_to(commands):\n    raise ZeroDivisionError('a fault')\n"
    (tmp_path / "odd.py").write_text(code)
    register(tmp_path, "odd", COMMANDS, ["odd = odd"])
    output = run(tmp_path, "", "--help")
    assert "sero_mj.commands: 'odd' of odd 0.1 (odd) cannot be loaded: ZeroDivisionError" in output
    assert "render" in output
    output = run(tmp_path, "", "rendr", code=2)
    assert "no command 'rendr'; did you mean 'render'?" in output and "Traceback" not in output


def test_command_plugin_runs_and_is_in_the_help(tmp_path: Path) -> None:
    install(tmp_path, "payload_command", COMMANDS, "carry", "Carry")
    assert run(tmp_path, "", "carry", "lwr").startswith("lwr: at most ")
    assert "carry      print the payload of a stretched arm" in run(tmp_path, "", "--help")
    assert "carry              payload_command:Carry from payload-command" in run(
        tmp_path, "", "list"
    )
