"""Rows of tables as packets, for `send`."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from sero_mj.base.errors import CsvError
from sero_mj.data.receive.structure import Structure
from sero_mj.extensions.tables.send import TablePackets


def test_columns_are_matched_to_numbers_of_a_packet_by_name(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("values0[1],time,values0[0],values1[0]\n1,5.0,0,2\n3,5.25,0,4\n")
    found = TablePackets(path, Structure("2F1F2F"))
    (first, one), (second, two) = found.packets()
    assert (first, second, found.duration) == (0.0, 0.25, 0.25)
    assert struct.unpack("<5d", one) == (0, 1, 2, 0, 0)
    assert struct.unpack("<5d", two) == (0, 3, 4, 0, 0)


@pytest.mark.parametrize("head", ["", "left,right,force\n"])
def test_other_columns_are_the_numbers_of_a_packet_in_order(tmp_path: Path, head: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text(f"{head}1,2,3\n4,5,6\n")
    found = TablePackets(path, Structure("2F1h"), rate=50)
    assert [(t, *struct.unpack("<ddh", packet)) for t, packet in found.packets()] == [
        (0.0, 1, 2, 3),
        (0.02, 4, 5, 6),
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n", "found 2 columns in addition to time: a, b, ...; expected 3 for '3F', or "
         "values0[0], values0[1], values0[2], ..."),
        ("values0[0],values0[7]\n1,2\n", "not a number of '3F'; did you mean 'values0[2]'?"),
    ],
)  # fmt: skip
def test_unsuitable_columns_are_reported(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text(text)
    with pytest.raises(CsvError) as caught:
        TablePackets(path, Structure("3F"), rate=1)
    assert message in str(caught.value) and str(path) in str(caught.value)


def test_event_with_missing_numbers_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("values0[0],values0[2],values1[0]\n1,2,3\n")
    with pytest.raises(CsvError) as caught:
        TablePackets(path, Structure("7F1F"), rate=1)
    assert str(caught.value) == (
        f"{path} has 2 of the 7 numbers of values0; missing columns: values0[1], values0[3], "
        "values0[4], values0[5], ..."
    )


def test_missing_events_are_reported_and_missing_frames_are_identity(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("values0[0],values0[1]\n1,2\n")
    structure = Structure("2F1M1V1H=7 1F")
    note = "missing events: vectors0, values1 (sent as zeros), matrices0 (sent as identity)"
    found = TablePackets(path, structure, rate=1)
    assert found.notes == [note]
    ((_, packet),) = found.packets()
    assert structure.decode(packet)["matrices0"][0].tolist() == np.eye(4).tolist()
    assert TablePackets(path, Structure("2F1H=7"), rate=1).notes == []
