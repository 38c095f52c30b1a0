"""Sources and routes: all errors in their declarations are reported, with suggestions."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import raises_with
from hypothesis import given
from hypothesis import strategies as st

from sero_mj.base.errors import DeclarationError
from sero_mj.base.plugins import SOURCES, plugins
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.drive.place import Router
from sero_mj.data.drive.wiring import wire
from sero_mj.data.receive.source import make_source
from sero_mj.data.receive.udp import UdpReceiver
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.inputs import OWNER_TOGGLES, list_inputs
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.robot_parts import VALUE_INPUTS
from sero_mj.robots.declared.scene import Scene

KINDS = [*plugins(SOURCES)]
LISTED = ", ".join(sorted(KINDS))

INPUTS = ("joint_angles", *VALUE_INPUTS)
ROBOT = """\
[robots.arm]
dh_convention = "craig"
dh_params = [[0, 0, 0, 0.3], [1.5, 0, 0, 0.2]]
"""
SOURCE = """\
[sources.udp]
kind = "udp"
structure = "2F2F3F"
"""
UDP = {"kind": "udp", "structure": "2F2F3F"}


def arm(name: str = "arm", n: int = 2) -> SerialRobot:
    return SerialRobot(name=name, dh_convention="craig", dh_params=[[1.0, 0.1, 0.0, 0.3]] * n)


def scene_of(routes: dict[str, str], sources: dict[str, Any] | None = None) -> Scene:
    sources = {"udp": UDP} if sources is None else sources
    return Scene(robots=[arm()], sources=sources, routes=routes)


def written(folder: Path, text: str) -> Path:
    file = folder / "scene.toml"
    file.write_text(text, encoding="utf-8")
    return file


def problems_in(file: Path, overrides: dict[str, Any] | None = None) -> list[str]:
    """Returns the problems that `load_scene` reports, without the folder."""
    with pytest.raises(DeclarationError) as caught:
        load_scene(file, overrides)
    return [str(problem).replace(f"{file.parent}/", "") for problem in caught.value.problems]


def test_source_is_made_from_its_table() -> None:
    table = {"kind": "udp", "structure": "1F", "port": 4711}
    source = make_source("robot", table)
    assert isinstance(source, UdpReceiver)
    assert (source.name, source.udpport) == ("robot", 4711)
    assert source.events == {"values0": (1,)}
    assert table["kind"] == "udp"  # the table is not changed
    assert make_source("other", source) is source


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({}, f"kind is required; expected {', '.join(map(repr, KINDS[:-1]))} or {KINDS[-1]!r}"),
        ({"kind": "tcp"}, f"kind: no kind 'tcp'; available: {LISTED}"),
        ({"kind": "upd"}, "kind: no kind 'upd'; did you mean 'udp'?"),
        ({"kind": 5}, f"kind: no kind 5; available: {LISTED}"),
        ({"kind": ["udp"]}, "kind: no kind ['udp']; did you mean 'udp'?"),
        ({"kind": {"udp": 1}}, f"kind: no kind {{udp = 1}}; available: {LISTED}"),
    ],
)
def test_unknown_kind_of_source_is_rejected(table: dict[str, Any], message: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        make_source("udp", table)
    assert str(caught.value).startswith(message)


def test_source_fields_have_one_name_in_files_and_one_in_python() -> None:
    in_file = UdpReceiver(structure="1F", port=4711, double=False)
    in_python = UdpReceiver(structure="1F", udpport=4711, is_double=False)
    assert in_file.model_dump() == in_python.model_dump()
    assert (in_file.udpport, in_file.is_double, in_file.port) == (4711, False, 4711)
    assert in_file.layout.size == 4
    assert UdpReceiver(structure="1F").layout.size == 8


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({}, "structure is required"),
        (
            {"structure": "7F7"},
            "structure: structure '7F7', character 4: found the end, "
            "expected F, V, M, T, x or a type after a count, for example 7F1M",
        ),
        ({"structure": 7}, "structure: found 7; expected string"),
        ({"structure": "1F", "port": 65536}, "port: found 65536; expected less than or equal"),
        ({"structure": "1F", "port": -1}, "port: found -1"),
        ({"structure": "1F", "port": "32000"}, "port: found '32000'; expected integer"),
        ({"structure": "1F", "hots": "::1"}, "hots: unknown key; did you mean 'host'?"),
        ({"structure": "1F", "double": 1}, "double: found 1"),
        ({"structure": "1F", "buffer_size": -1}, "buffer_size: found -1; expected greater than"),
    ],
)
def test_invalid_fields_of_a_source_are_rejected(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        make_source("udp", {"kind": "udp", **fields})
    assert str(caught.value).startswith(message)
    assert len(caught.value.problems) == 1


def test_all_errors_of_a_source_are_reported_at_once() -> None:
    wiring = wire(scene_of({}, {"udp": {"kind": "udp", "structure": "x", "port": -1, "hots": ""}}))
    keys = ["sources.udp.structure", "sources.udp.port", "sources.udp.hots"]
    assert sorted(problem.key for problem in wiring.problems) == sorted(keys)
    assert wiring.sources == {}


def test_valid_route_has_robot_input_source_and_event() -> None:
    scene = scene_of({"arm.joint_angles": "udp.values0", "arm.torques": "udp.values1"})
    wiring, inputs = wire(scene), list_inputs(scene)
    assert wiring.problems == []
    assert [(route.to, route.value.whole, route.text) for route in wiring.routes] == [
        (inputs["arm.joint_angles"], ("udp", "values0", True), "udp.values0"),
        (inputs["arm.torques"], ("udp", "values1", True), "udp.values1"),
    ]
    assert [route.direct for route in wiring.routes] == ["udp", "udp"]
    assert wiring.routes[1].to.target == "arm.torques"
    assert list(wiring.sources) == ["udp"]


@pytest.mark.parametrize(
    ("target", "event", "messages"),
    [
        ("arn.torques", "udp.values0", ["no robot 'arn'; did you mean 'arm'?"]),
        ("x.torques", "udp.values0", ["no robot 'x'; available: arm"]),
        ("torques", "udp.values0", ["no robot 'torques'; available: arm"]),
        ("arm.torque", "udp.values0", ["no input 'torque' of arm; did you mean 'torques'?"]),
        (
            "arm.x",
            "udp.values0",
            [
                f"no input 'x' of arm; available: "
                f"{', '.join(sorted([*INPUTS, *OWNER_TOGGLES, 'base_frame', 'flange_check']))}"
            ],
        ),
        (
            "arm.torques.0",
            "udp.values0",
            ["no input 'torques.0' of arm; did you mean 'torques'?"],
        ),
        ("arm.torques", "upd.values0", ["no source 'upd'; did you mean 'udp'?"]),
        ("arm.torques", "values0", ["no source 'values0'; available: udp"]),
        ("arm.torques", "udp.value1", ["no event 'value1' of udp; did you mean 'values1'?"]),
        (
            "arm.torques",
            "udp.x",
            [
                "no event 'x' of udp; available: receive_trigger, receiving, values0, values1, "
                "values2"
            ],
        ),
        (
            "arm.torques",
            "udp.values2",
            ["udp.values2 has 3 values, but arm.torques takes 2, one per joint"],
        ),
        (
            "arn.torques",
            "upd.values0",
            ["no robot 'arn'; did you mean 'arm'?", "no source 'upd'; did you mean 'udp'?"],
        ),
    ],
)
def test_invalid_route_is_reported_with_the_nearest_name(
    target: str, event: str, messages: list[str]
) -> None:
    wiring = wire(scene_of({target: event, "arm.billboard_values": "udp.values0"}))
    assert [problem.message for problem in wiring.problems] == messages
    assert {problem.key for problem in wiring.problems} == {f"routes.{target}"}
    assert [route.to.target for route in wiring.routes] == ["arm.billboard_values"]


@given(st.text(max_size=20), st.text(max_size=20))
def test_any_text_is_a_route_or_a_problem(target: str, event: str) -> None:
    wiring = wire(scene_of({target: event}))
    assert len(wiring.routes) + bool(wiring.problems) == 1


def test_mirror_rejects_invalid_routes() -> None:
    with raises_with(key="routes.arm.torques", reason="no source 'upd'; did you mean 'udp'?"):
        Mirror(scene_of({"arm.torques": "upd.values0"}))


@pytest.mark.parametrize("key", INPUTS)
def test_router_writes_only_its_input(key: str) -> None:
    scene = Scene(
        robots=[arm("left", 3), arm("right", 3)],
        sources={"udp": {"kind": "udp", "structure": "3F"}},
        routes={f"right.{key}": "udp.values0"},
        floor=False,
    )
    world = World(scene)
    data, untouched = world.make_data(), world.make_data()
    values = np.array([0.1, -0.2, 0.3])
    router = Router(world, wire(scene).routes)
    router.apply(data, {"udp": {"values0": values}})
    flag = world.flags[f"right.{key}"]
    assert data.userdata[flag] == 1.0
    untouched.userdata[flag] = 1.0
    if key == "joint_angles":
        assert (data.qpos[world.robots["right"].qpos] == values).all()
        untouched.qpos[world.robots["right"].qpos] = values
    else:
        assert (data.userdata[world.slots[f"right.{key}"]] == values).all()
        untouched.userdata[world.slots[f"right.{key}"]] = values
    assert (data.qpos == untouched.qpos).all()
    assert (data.userdata == untouched.userdata).all()


def test_one_packet_drives_several_robots() -> None:
    scene = Scene(
        robots=[arm("left", 7), arm("right", 7)],
        sources={"udp": {"kind": "udp", "structure": "7F7F7F7F"}},
        routes={
            "left.joint_angles": "udp.values0",
            "left.torques": "udp.values1",
            "right.joint_angles": "udp.values2",
            "right.torques": "udp.values3",
        },
        floor=False,
    )
    world, wiring = World(scene), wire(scene)
    data, numbers = world.make_data(), np.linspace(-1, 1, 28)
    values = wiring.sources["udp"].layout.decode(struct.pack("<28d", *numbers))
    Router(world, wiring.routes).apply(data, {"udp": values})
    assert (data.qpos[world.robots["left"].qpos] == numbers[:7]).all()
    assert (data.userdata[world.slots["left.torques"]] == numbers[7:14]).all()
    assert (data.qpos[world.robots["right"].qpos] == numbers[14:21]).all()
    assert (data.userdata[world.slots["right.torques"]] == numbers[21:]).all()


def test_one_event_is_routed_to_several_inputs() -> None:
    scene = scene_of(dict.fromkeys((f"arm.{key}" for key in INPUTS), "udp.values0"))
    world, wiring = World(scene), wire(scene)
    assert [route.to.key for route in wiring.routes] == list(INPUTS)
    data, values = world.make_data(), np.array([0.5, -0.5])
    Router(world, wiring.routes).apply(data, {"udp": {"values0": values}})
    assert (data.qpos == values).all()
    for key in VALUE_INPUTS:
        assert (data.userdata[world.slots[f"arm.{key}"]] == values).all()
    assert (data.userdata[[world.flags[f"arm.{key}"] for key in INPUTS]] == 1.0).all()


def test_all_errors_in_a_file_are_reported_at_once_with_file_line_and_key(tmp_path: Path) -> None:
    file = written(
        tmp_path,
        ROBOT.replace("craig", "crag")
        + SOURCE.replace("3F", "3X")
        + """\
[sources.other]
kind = "udp"
structure = "3F"
[routes]
"arm.joint_angles" = "udp.values7"
"arm.torque" = "other.values0"
"amr.torques" = "ohter.values0"
"arm.torques" = "other.values1"
""",
    )
    assert sorted(problems_in(file)) == sorted(
        [
            "scene.toml:2: robots.arm.dh_convention: found 'crag'; "
            "expected 'craig', 'standard' or 'none'; did you mean 'craig'?",
            "scene.toml:6: sources.udp.structure: structure '2F2F3X', character 6: found 'X', "
            "expected F, V, M, T, x or a type after a count, for example 7F1M",
            "scene.toml:12: routes.arm.torque: no input 'torque' of arm; did you mean 'torques'?",
            # The robot exists, although it is invalid, so its name is suggested.
            "scene.toml:13: routes.amr.torques: no robot 'amr'; did you mean 'arm'?",
            "scene.toml:13: routes.amr.torques: no source 'ohter'; did you mean 'other'?",
            "scene.toml:14: routes.arm.torques: "
            "no event 'values1' of other; did you mean 'values0'?",
        ]
    )


@pytest.mark.parametrize(
    ("robot", "sources", "only"),
    [
        ('[robots.arm]\nmodel = "broken"\n', SOURCE, "broken/robot.toml:1: dh_convention: found"),
        (
            '[robots.arm]\nmodel = "none"\n',
            SOURCE,
            "scene.toml:2: robots.arm.model: no robot model",
        ),
        ("[robots]\narm = 5\n", SOURCE, "scene.toml:2: robots.arm: found 5"),
        ("robots = 5\n", SOURCE, "scene.toml:1: robots: found 5; expected a table [robots]"),
        (ROBOT, "[sources]\nudp = 5\n", "scene.toml:5: sources.udp: found 5"),
        (
            ROBOT,
            '[sources.udp]\nkind = ["udp"]\n',
            "scene.toml:5: sources.udp.kind: no kind ['udp']",
        ),
    ],
    ids=["file", "no file", "entry", "section", "source", "kind"],
)
def test_one_mistake_causes_one_problem(
    tmp_path: Path, robot: str, sources: str, only: str
) -> None:
    # The route is valid. Reporting it would mislead the author.
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken/robot.toml").write_text('dh_convention = "crag"\ndh_params = [[0,0,0,1]]')
    routes = '[routes]\n"arm.torques" = "udp.values0"\n'
    (problem,) = problems_in(written(tmp_path, robot + sources + routes))
    assert problem.startswith(only)


def test_route_without_quotes_is_reported_with_its_line(tmp_path: Path) -> None:
    routes = '[routes]\n"arm.joint_angles" = "udp.values0"\narm.torques = "udp.values1"\n'
    (problem,) = problems_in(written(tmp_path, ROBOT + SOURCE + routes))
    assert problem.endswith("; put quotes around the whole name")
    assert problem.startswith("scene.toml:9: routes.arm")


def test_mistyped_section_is_one_mistake(tmp_path: Path) -> None:
    routes = '[routes]\n"arm.joint_angles" = "udp.values0"\n"arm.torques" = "udp.values1"\n'
    for section in ("sources", "robots"):
        text = (ROBOT + SOURCE + routes).replace(f"[{section}.", f"[{section[:-1]}.")
        (problem,) = problems_in(written(tmp_path, text))
        assert f"{section[:-1]}: unknown section; did you mean '{section}'?" in problem


def test_route_to_an_overridden_input_is_removed(tmp_path: Path) -> None:
    routes = '[routes]\n"arm.joint_angles" = "udp.values0"\n"arm.torques" = "udp.values1"\n'
    file = written(tmp_path, ROBOT + SOURCE + routes)
    assert len(load_scene(file).routes) == 2
    scene = load_scene(file, {"arm.joint_angles": [0.5, -0.5], "arm.show_axes": True})
    assert scene.routes == {"arm.torques": "udp.values1"}
    assert scene.robots["arm"].home.tolist() == [0.5, -0.5]
    assert scene.robots["arm"].show_axes


@pytest.mark.parametrize(
    ("text", "target", "message"),
    [
        (ROBOT, "amr.torques", "amr.torques: no robot 'amr' to set this for; did you mean 'arm'?"),
        (ROBOT, "arm.torques", "robots.arm.torques: found 3 entries"),
        ("robots = 5\n", "arm.torques", "robots: found 5"),
        ("routes = 5\n" + ROBOT, "arm.joint_angles", "routes: found 5; expected a table [routes]"),
    ],
    ids=["robot", "length", "robots", "routes"],
)
def test_invalid_overrides_are_reported(
    tmp_path: Path, text: str, target: str, message: str
) -> None:
    problems = problems_in(written(tmp_path, text), {target: [1.0, 2.0, 3.0]})
    assert any(message in problem for problem in problems), problems
