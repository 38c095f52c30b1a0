"""Recorded values by joint name and with units, for third-party programs."""

from __future__ import annotations

import math
import socket
from pathlib import Path

import numpy as np
import pytest
from recordings import signals_in

from sero_mj import Group, Scene, SerialRobot, SmartArrow, UdpReceiver
from sero_mj.cli import main
from sero_mj.data.drive.record_sources import RoutedSignals, joint_names, record_sources
from sero_mj.data.drive.wiring import wire
from sero_mj.data.record.recording import Recording
from sero_mj.data.record.recording_format import Signals

STRUCTURE = "2F2F1V1F"
TWO = {
    "dh_convention": "craig",
    "dh_params": [[0, 0.3, 0, 0], [0, 0.3, 0, 0]],
    "joint_types": ["revolute", "prismatic"],
    "joint_names": ["turn", "slide"],
}


def test_routed_values_are_named_after_their_joint(tmp_path: Path) -> None:
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
    channel, schema, found = signals_in(tmp_path / "a.mcap", "/udp/signals")
    np.testing.assert_equal(found, {0: {
        "two_turn_angle": math.pi,
        "two_slide_angle": 0.25,
        "two_turn_torque": 1 / 3,
        "two_slide_torque": math.nan,
        "push_x": 1,
        "push_y": 2,
        "push_z": 3,
        "values2": [7],
    }})  # fmt: skip
    assert channel.metadata["two.slide.torque [N]"] == "values1[1]"
    origin = "([udp.values0[0] * deg, udp.values0[1]])[0]"
    assert channel.metadata["two.turn.angle [rad]"] == origin
    lines = schema.data.decode().splitlines()
    assert lines[0] == f"float64 two_turn_angle  # two.turn.angle [rad], from {origin}"
    assert lines[3] == "float64 two_slide_torque  # two.slide.torque [N], from values1[1]"
    with Recording(tmp_path / "a.mcap") as recording:  # if the packet is complete
        ((_, kept),) = recording.packets("udp")
    assert kept == packet


def test_values_of_a_group_are_read_from_their_places_in_the_packet() -> None:
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
        "first.turn.torque [Nm]": "(2 * udp.values2)[2]",  # the coupled joint is unknown
    }  # fmt: skip


def test_recorded_simulation_has_signal_names(tmp_path: Path) -> None:
    out = tmp_path / "run.mcap"
    with pytest.raises(SystemExit):
        main(["simulate", "impedance_push", "--record", str(out)])
    channel, _, numbered = signals_in(out, "/simulation/signals")
    found = list(numbered.values())
    assert found[0]["lwr_a2_angle"] == pytest.approx(0.6)
    assert abs(found[-1]["lwr_a2_torque"]) > 1.0
    assert "lwr_a2_target_angle" in found[0] and "time" in found[0]
    assert channel.metadata["lwr.A2.commanded_torque [Nm]"] == "lwr_commanded_torques[1]"


def test_names_of_any_characters_are_listed_beside_valid_ros_names() -> None:
    names = ["r.hüfte.angle [rad]", "r.关节.angle [rad]", "r.関節.angle [rad]", "r.1/a.angle [rad]"]
    signals = Signals({"r.joint_angles": (4,), "2d": (1,)}, {"r.joint_angles": names})
    assert signals.fields == ["r_hufte_angle", "r_angle", "r_angle_2", "r_1_a_angle", "n2d"]
    for line, name in zip(signals.schema().decode().splitlines(), names, strict=False):
        assert line.endswith(f"  # {name}")
    assert Signals({}).schema() == b"uint8 structure_needs_at_least_one_member"


def test_declared_input_has_the_unit_of_its_billboard() -> None:
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
