"""Recorded values by the name of their joint and with their unit, for other programs."""

from __future__ import annotations

import json
import math
import socket
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from sero_mj import Group, Scene, SerialRobot, SmartArrow, UdpReceiver
from sero_mj.cli import main
from sero_mj.data.drive.record_sources import RoutedSignals, joint_names, record_sources
from sero_mj.data.drive.wiring import wire
from sero_mj.data.record.recording import Recording

STRUCTURE = "2F2F1V1F"
TWO = {
    "dh_convention": "craig",
    "dh_params": [[0, 0.3, 0, 0], [0, 0.3, 0, 0]],
    "joint_types": ["revolute", "prismatic"],
    "joint_names": ["turn", "slide"],
}


def messages(path: Path, topic: str) -> tuple[dict[str, str], dict[str, Any], list[dict[str, Any]]]:
    """A channel's metadata, the properties of its schema, and its messages."""
    with open(path, "rb") as file:
        found = list(make_reader(file).iter_messages(topics=[topic]))
    schema, channel, _ = found[0]
    assert schema is not None
    properties = json.loads(schema.data)["properties"]
    return channel.metadata, properties, [json.loads(each.data) for _, _, each in found]


def test_routed_values_are_called_after_their_joint(tmp_path: Path) -> None:
    source = UdpReceiver(structure=STRUCTURE)
    scene = Scene(
        robots=[SerialRobot(name="two", **TWO)],  # type: ignore[arg-type]
        arrows=[SmartArrow(name="push", kind="force", at="two/flange")],
        sources={"udp": source},
        routes={
            "two.joint_angles": "[udp.values0[0] * deg, udp.values0[1]]",
            "two.torques": "udp.values1",
            "push.vector": "udp.vectors0",
        },
    )
    with source, record_sources({"udp": source}, tmp_path / "a.mcap", scene=scene) as recorder:
        packet = source.layout.encode(
            {"values0": [180.0, 0.25], "values1": [1 / 3, math.nan], "vectors0": [[1, 2, 3]],
             "values2": [7.0]}
        )  # fmt: skip
        source.allow_nan(["values1"])
        with socket.socket(type=socket.SOCK_DGRAM) as sock:
            sock.sendto(packet, ("127.0.0.1", source.port))
            assert source.wait(5.0)
        assert recorder.error is None
    metadata, properties, (found,) = messages(tmp_path / "a.mcap", "/udp/signals")
    assert found == {
        "two.turn.angle [rad]": 3.141593,
        "two.slide.angle [m]": 0.25,
        "two.turn.torque [Nm]": 0.3333333,
        "two.slide.torque [N]": None,
        "push.x [N]": 1,
        "push.y [N]": 2,
        "push.z [N]": 3,
        "values2": [7],
    }
    assert list(properties) == list(found)
    assert metadata["two.slide.torque [N]"] == "values1[1]"
    assert metadata["two.turn.angle [rad]"] == "([udp.values0[0] * deg, udp.values0[1]])[0]"
    assert properties["two.slide.torque [N]"] == {"type": "number", "description": "values1[1]"}
    with Recording(tmp_path / "a.mcap") as recording:  # where the packet is whole
        ((_, kept),) = recording.packets("udp")
    assert kept == packet


def test_values_of_a_group_lead_from_their_own_places_in_the_packet() -> None:
    robots = [SerialRobot(name=name, **TWO) for name in ("first", "second")]  # type: ignore[arg-type]
    robots[0].couplings = {"slide": {"to": "turn", "ratio": 2.0}}  # type: ignore[assignment]
    scene = Scene(
        robots=robots, groups=[Group(name="both", robots=["second", "first"])],
        sources={"udp": {"kind": "udp", "port": 0, "structure": "3F4F3F"}},
        routes={
            "both.joint_angles": "udp.values0",
            "both.billboard_values": "-1 * udp.values1",
            "both.torques": "2 * udp.values2",
        },
    )  # fmt: skip
    wiring = wire(scene).check(scene)
    signals = RoutedSignals(scene, wiring.routes, "udp", wiring.sources["udp"].events).signals
    assert signals.origins == {
        "second.turn.angle [rad]": "values0[0]", "second.slide.angle [m]": "values0[1]",
        "first.turn.angle [rad]": "values0[2]", "first.slide.angle [m]": "(udp.values0)[2]",
        "second.turn.billboard_value": "(-1 * udp.values1)[0]",
        "second.slide.billboard_value": "(-1 * udp.values1)[1]",
        "first.turn.billboard_value": "(-1 * udp.values1)[2]",
        "first.slide.billboard_value": "(-1 * udp.values1)[3]",
        "second.turn.torque [Nm]": "(2 * udp.values2)[0]",
        "second.slide.torque [N]": "(2 * udp.values2)[1]",
        "first.turn.torque [Nm]": "(2 * udp.values2)[2]",  # of the coupled joint nothing is known
    }  # fmt: skip


def test_a_simulation_has_them_too(tmp_path: Path) -> None:
    out = tmp_path / "run.mcap"
    with pytest.raises(SystemExit):
        main(["simulate", "impedance_push", "--record", str(out)])
    metadata, _, found = messages(out, "/simulation/signals")
    assert found[0]["lwr.A2.angle [rad]"] == pytest.approx(0.6)
    assert abs(found[-1]["lwr.A2.torque [Nm]"]) > 1.0
    assert "lwr.A2.target_angle [rad]" in found[0] and "time" in found[0]
    assert metadata["lwr.A2.commanded_torque [Nm]"] == "lwr_commanded_torques[1]"


def test_an_input_of_its_own_has_the_unit_of_its_billboard() -> None:
    robot = SerialRobot(
        name="two",
        inputs=["temperatures", "load"],
        billboard_lines=[{"value": "temperatures", "unit": "K"}],
        **TWO,  # type: ignore[arg-type]
    )
    assert joint_names("two", robot, "temperatures") == [
        "two.turn.temperature [K]", "two.slide.temperature [K]",
    ]  # fmt: skip
    assert joint_names("two", robot, "load") == ["two.turn.load", "two.slide.load"]
