"""The corner of the image with errors of sources."""

from __future__ import annotations

import socket
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from decor_tools import GEOM, belonging, corner_lines, labels, of_kind, rectangle, view_at
from polling import until
from source_slots import set_source

from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.receive.structure import Structure
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.viewer.decor.billboard_layout import move_below
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.font import line_height
from sero_mj.viewer.decor.geom_buffer import Kind
from sero_mj.viewer.decor.panels import Panels
from sero_mj.viewer.decor.status import FAULT_RGBA
from sero_mj.viewer.decor.toggles import Toggles
from sero_mj.viewer.image.typesetting import Typesetter


def udp_scene(**udp: Any) -> Scene:
    lwr = SerialRobot.from_model("lwr")
    source = {"kind": "udp", "port": 0, "structure": "7F", **udp}
    return Scene(robots=[lwr], sources={"udp": source}, routes={"lwr.joint_angles": "udp.values0"})


def test_expected_packets_are_shown_until_some_arrive() -> None:
    scene = load_scene("lwr_udp")
    scene.toggles.legend = False
    world = World(scene)
    decor, data, toggles = Decor(world), world.make_data(), Toggles(world)

    def shown_lines() -> list[str]:
        buffer = decor.draw(data, toggles, view_at())
        return [text for text in labels(buffer.rows[: buffer.count]) if "lwr: no data" not in text]

    set_source(data, world, "udp", received=0, size=112, age=-1)
    assert shown_lines() == [
        "no packet yet on UDP 127.0.0.1:32000",
        "  expected: packets of 112 bytes",
        "  test with: sero-mj send lwr_udp",
    ]
    toggles.status = False
    assert shown_lines() == []
    toggles.status = True
    # Errors of packets are shown instead.
    set_source(data, world, "udp", received=1, malformed=1, wrong_size=1, last_size=5, size=112,
               fault_age=0.1, age=-1)  # fmt: skip
    assert shown_lines() == ["udp: 1 of 1 packets not applied", "  5 bytes, expected 112"]
    set_source(data, world, "udp", received=1, size=112)
    assert shown_lines() == []


def test_nothing_is_expected_from_files(tmp_path: Path) -> None:
    scene = udp_scene()
    scene.sources = {"replay": {"kind": "replay", "file": str(tmp_path / "run.mcap")}}
    scene.routes = {}
    world = World(scene)
    data = world.make_data()
    assert (
        labels((buffer := Decor(world).draw(data, Toggles(world), view_at())).rows[: buffer.count])
        == []
    )


@pytest.mark.parametrize(
    ("counts", "expected"),
    [
        ({"received": 9}, []),
        (
            {"received": 12, "malformed": 3, "wrong_size": 2, "last_size": 5, "fault_age": 1},
            ["udp: 3 of 12 packets not applied", "  5 bytes, expected 56",
             "  some values are NaN or infinite"],
        ),
        (
            {"received": 12, "malformed": 1, "wrong_size": 1, "last_size": 5, "fault_age": 1},
            ["udp: 1 of 12 packets not applied", "  5 bytes, expected 56"],
        ),
        (
            {"received": 12, "malformed": 3, "wrong_size": 2, "last_size": 5, "fault_age": 1,
             "not_frames": 1},
            ["udp: 3 of 12 packets not applied", "  5 bytes, expected 56",
             "  a received matrix is not a frame"],
        ),
        (
            {"received": 12, "malformed": 2, "fault_age": 1, "wrong_constant": 2},
            ["udp: 2 of 12 packets not applied",
             "  wrong constant: another kind of packet"],
        ),
        ({"received": 12, "malformed": 3, "wrong_size": 3, "fault_age": 6.0}, []),  # long ago
        ({"received": 12, "lost": 3, "link_age": 0.5}, ["udp: 3 packets lost"]),
        (
            {"received": 12, "lost": 3, "late": 1, "duplicates": 2, "dropped": 5, "link_age": 0.5},
            ["udp: 3 packets lost, 1 late", "  2 packets duplicated, 5 dropped by this machine"],
        ),
        ({"received": 12, "lost": 3, "late": 1, "link_age": 5.5}, []),
        (  # they may be the same packets
            {"received": 12, "malformed": 3, "wrong_size": 3, "last_size": 5, "fault_age": 1,
             "lost": 3, "link_age": 1},
            ["udp: 3 of 12 packets not applied", "  5 bytes, expected 56",
             "udp: 3 packets lost or not applied"],
        ),
        ({"received": 12, "restarts": 1, "link_age": 1}, ["udp: the sender restarted"]),
        ({"received": 12, "restarts": 4, "link_age": 1}, ["udp: the sender restarted 4 times"]),
        (
            {"received": 12, "senders": 3},
            ["udp: 3 concurrent senders; set sender = ... to choose one"],
        ),
        ({"received": 12, "senders": 1}, []),
        (
            {"received": 12, "foreign": 3, "foreign_age": 0.5},
            ["udp: 3 packets from other senders"],
        ),
        ({"received": 12, "foreign": 3, "foreign_age": 5.5}, []),
    ],
)  # fmt: skip
def test_errors_of_a_source_are_shown_in_the_corner(
    counts: dict[str, float], expected: list[str]
) -> None:
    world = World(udp_scene())
    data = world.make_data()
    set_source(data, world, "udp", **{"age": 0.1, "size": 56, **counts})
    view = view_at()
    buffer = Decor(world).draw(data, Toggles(world), view)
    rows = buffer.rows[: buffer.count]
    assert labels(rows) == expected
    for row in of_kind(rows, GEOM.mjGEOM_BOX):
        low, high = rectangle(view, row)
        assert low[0] >= 0 and high[1] <= view.height
        assert high[0] < view.width / 2 and low[1] > view.height / 2


FAULTS = {"received": 99, "age": 0.1, "size": 56, "malformed": 9, "wrong_size": 3, "not_frames": 2,
          "wrong_constant": 1, "last_size": 5, "fault_age": 1, "lost": 3, "late": 7,
          "duplicates": 2, "restarts": 4, "link_age": 0.5, "senders": 3}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("counts", [FAULTS, {**FAULTS, "malformed": 0}])
@pytest.mark.parametrize("size", [(640, 480), (800, 600), (1280, 800)])
@pytest.mark.parametrize("distance", [1.2, 2.0, 3.5])
@pytest.mark.parametrize("azimuth", [0.7, 2.9])
def test_errors_cover_no_billboard(
    counts: dict[str, float], size: tuple[int, int], distance: float, azimuth: float
) -> None:
    scene = udp_scene()
    lwr = SerialRobot.from_model(
        "lwr", show_arrows=True, show_billboards=True,
        billboard_lines=["torques", "joint_angles", "torque_error"],
    )  # fmt: skip
    scene.robots["lwr"] = lwr
    world = World(scene)
    data = world.make_data()
    set_source(data, world, "udp", **counts)
    font = Typesetter(line_height(world, *size)).font
    view = replace(view_at(azimuth, distance, *size), font=font)
    buffer = Decor(world).draw(data, Toggles(world), view)
    rows = buffer.rows[: buffer.count]
    panels = [rectangle(view, row) for row in belonging(buffer, Kind.BILLBOARD)]
    boxes = of_kind(rows, GEOM.mjGEOM_BOX)
    faults = [row for row in boxes if tuple(row["rgba"]) == pytest.approx(FAULT_RGBA)]
    assert len(panels) >= 5 and len(faults) == 1
    for (low, high), (other_low, other_high) in combinations(
        [rectangle(view, faults[0]), *panels], 2
    ):
        assert (other_low >= high - 1e-3).any() or (other_high <= low + 1e-3).any()


@pytest.mark.parametrize(("width", "lowered"), [(400.0, 40.0), (200.0, 0.0)])
def test_errors_are_below_the_flange_check_if_they_overlap(width: float, lowered: float) -> None:
    # In an image of 640 x 480: a line in the right corner and errors in the left one.
    right = Panels(np.array([[480.0, 455.0]]), np.array([[300.0, 30.0]]), [[b"off"]])
    faults = Panels(np.array([[10 + width / 2, 430.0]]), np.array([[width, 100.0]]), [[b"lost"]])
    moved = move_below(right, faults)
    assert moved.centres.tolist() == [[10 + width / 2, 430.0 - lowered]]


def test_source_without_routes_is_not_reported() -> None:
    lwr = SerialRobot.from_model("lwr")
    world = World(Scene(robots=[lwr], sources={"udp": {"kind": "udp", "structure": "7F"}}))
    data = world.make_data()
    set_source(data, world, "udp", size=56)
    assert Decor(world).draw(data, Toggles(world), view_at()).count == 0


def corner(mirror: Mirror) -> list[str]:
    """Returns the text of the corner after the received packets are applied."""
    mirror.advance()
    return corner_lines(mirror)


def test_lost_and_mixed_packets_are_shown() -> None:
    layout = Structure("number:1I 7F")
    scene = udp_scene(structure=layout.text, sequence="number")
    with Mirror(scene) as mirror, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        source: Any = mirror.sources["udp"]
        come = 0

        def send(*numbers: int) -> None:
            nonlocal come
            for number in numbers:
                sender.sendto(layout.encode({"number": [number]}), ("127.0.0.1", source.port))
            come += len(numbers)
            assert until(lambda: source.counters.received == come)

        send(5000, 5001, 5002)
        assert corner(mirror) == []
        send(5005, 5004, 5005)
        assert corner(mirror) == ["udp: 1 packet lost, 1 late", "  1 packet duplicated"]
        send(1, 2, 3, 4)
        assert corner(mirror)[-1] == "udp: the sender restarted"
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.sendto(layout.encode({"number": [9]}), ("127.0.0.1", source.port))
            come += 1
            assert until(lambda: source.counters.received == come)
            send(5)  # the second sender has not replaced it
        assert corner(mirror)[-1] == "udp: 2 concurrent senders; set sender = ... to choose one"


def test_received_angles_in_degrees_are_detected() -> None:
    layout = Structure("7F")
    with Mirror(udp_scene()) as mirror, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        source: Any = mirror.sources["udp"]
        decor = Decor(mirror.world)
        for come, (angle, expected) in enumerate(
            [(1.0, []), (80.0, ["lwr.A2", "Is it in degrees?"])]
        ):
            values = {"values0": [0, angle, 0, 0, 0, 0, 0]}
            sender.sendto(layout.encode(values), ("127.0.0.1", source.port))
            assert until(lambda wanted=come + 1: source.counters.received == wanted)
            mirror.advance()
            buffer = decor.draw(mirror.data, Toggles(mirror.world), view_at())
            lines = labels(buffer.rows[: buffer.count])
            assert [line.strip().split(":")[0] for line in lines] == expected
