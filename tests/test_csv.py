"""Tables of `export`: packets of a recording in full precision."""

from __future__ import annotations

import csv
import math
import os
from pathlib import Path

import numpy as np
import pytest
from conftest import examples, raises_with
from hypothesis import given, settings
from hypothesis import strategies as st

from sero_mj.base.errors import CsvError, UnknownName
from sero_mj.cli import main
from sero_mj.data.receive.structure import Structure
from sero_mj.data.record.csv_files import Exported, column_names, csv_table, export_csv
from sero_mj.data.record.recording import Recording
from sero_mj.data.record.recording_writer import RecordingWriter

LAYOUT = Structure("2F1V1M")


def record(path: Path, packets: list[bytes]) -> Path:
    with RecordingWriter(path, about={}, overwrite=True) as writer:
        writer.add_source("arm", kind="udp", declared={}, events=LAYOUT.events, size=LAYOUT.size)
        for i, packet in enumerate(packets):
            writer.write_raw("arm", packet, writer.clock.monotonic_ns / 1e9 + i / 8)
    return path


def packet(*values: float) -> bytes:
    frame = np.arange(16.0).reshape(4, 4)
    return LAYOUT.encode({"values0": values, "vectors0": [1.0, 2.0, 3.0], "matrices0": frame})


def read_csv(path: Path) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    with open(path, newline="", encoding="utf-8") as file:
        names, *rows = csv.reader(file)
    numbers = np.array(rows, float).reshape(-1, len(names))
    return numbers[:, 0], dict(zip(names[1:], numbers[:, 1:].T, strict=True))


def test_columns_are_named_by_event_and_index() -> None:
    assert column_names({"values0": (2,), "vectors0": (1, 3)}) == [
        "values0[0]",
        "values0[1]",
        "vectors0[0][0]",
        "vectors0[0][1]",
        "vectors0[0][2]",
    ]
    assert column_names(LAYOUT.events)[-1] == "matrices0[0][3][3]"


def test_each_valid_packet_is_a_row_and_malformed_ones_are_counted(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", [packet(0.1, math.nan), b"short", packet(1e-300, -2.0)])
    with Recording(path) as recording:
        exported = export_csv(recording, "arm", tmp_path / "a.csv", LAYOUT.decode)
    assert exported == Exported(rows=2, malformed=1)
    lines = (tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == ",".join(["time", *column_names(LAYOUT.events)])
    # Packets have column-major matrices, but column names have row and column indices.
    numbers = ",".join(repr(float(i)) for i in range(16))
    assert lines[1].partition(",")[2] == f"0.1,nan,1.0,2.0,3.0,{numbers}"
    assert lines[2].partition(",")[2] == f"1e-300,-2.0,1.0,2.0,3.0,{numbers}"
    assert len(lines) == 3
    assert float(lines[2].partition(",")[0]) == pytest.approx(0.25, abs=1e-6)
    assert [file.name for file in tmp_path.iterdir() if "csv" in file.name] == ["a.csv"]


def test_part_of_a_recording_is_exported(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", [packet(float(i), 0.0) for i in range(20)])
    with Recording(path) as recording:
        export_csv(recording, "arm", tmp_path / "a.csv", LAYOUT.decode, start=0.99, stop=1.49)
    _, columns = read_csv(tmp_path / "a.csv")
    assert columns["values0[0]"].tolist() == [8.0, 9.0, 10.0, 11.0]


@settings(max_examples=examples(25), deadline=None)
@given(rows=st.lists(st.tuples(st.floats(), st.floats()), min_size=1, max_size=20))
def test_exported_numbers_are_read_back_exactly(
    tmp_path_factory: pytest.TempPathFactory, rows: list[tuple[float, float]]
) -> None:
    folder = tmp_path_factory.mktemp("csv")
    path = record(folder / "a.mcap", [packet(*row) for row in rows])
    with Recording(path) as recording:
        export_csv(recording, "arm", folder / "a.csv", LAYOUT.decode)
        expected = [t for t, _ in recording.packets("arm")]
    times, columns = read_csv(folder / "a.csv")
    assert times.tolist() == expected
    assert list(columns) == column_names(LAYOUT.events)
    np.testing.assert_array_equal(columns["values0[0]"], [row[0] for row in rows])
    np.testing.assert_array_equal(columns["values0[1]"], [row[1] for row in rows])


def test_failed_export_is_reported_and_leaves_no_partial_file(tmp_path: Path) -> None:
    def broken(data: bytes) -> None:
        raise ZeroDivisionError

    (tmp_path / "a.csv").write_text("before")
    with Recording(record(tmp_path / "a.mcap", [packet(1.0, 2.0)] * 3)) as recording:
        with raises_with(
            CsvError,
            path=f"{tmp_path}/no/a.csv",
            reason="cannot be written: No such file or directory",
        ):
            export_csv(recording, "arm", tmp_path / "no" / "a.csv", LAYOUT.decode)
        with raises_with(UnknownName, kind="source", name="leg"):
            export_csv(recording, "leg", tmp_path / "a.csv", LAYOUT.decode)
        with pytest.raises(ZeroDivisionError):
            export_csv(recording, "arm", tmp_path / "a.csv", broken)
    assert (tmp_path / "a.csv").read_text() == "before"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.csv", "a.mcap"]


def test_table_is_written_through_links_and_into_pipes(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "link.csv").symlink_to(tmp_path / "there" / "a.csv")
    with csv_table(tmp_path / "link.csv") as table:
        table.writerow(["a", 1])
        assert [file.name for file in (tmp_path / "there").iterdir()] == ["a.csv.part"]
    assert (tmp_path / "link.csv").is_symlink()
    assert (tmp_path / "there" / "a.csv").read_text() == "a,1\n"
    os.mkfifo(tmp_path / "pipe")
    end = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    with csv_table(tmp_path / "pipe") as table:
        table.writerow(["b", 2])
    assert os.read(end, 100) == b"b,2\n"
    os.close(end)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["link.csv", "pipe", "there"]


def test_command_exports_nan_and_fails_without_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    layout = Structure("2F")

    def recorded(name: str, packet: bytes) -> list[str]:
        path = tmp_path / f"{name}.mcap"
        with RecordingWriter(path, about={}) as writer:
            declared = {"port": 1, "structure": "2F"}
            writer.add_source("arm", kind="udp", declared=declared, events=layout.events, size=16)
            for i in range(3):
                writer.write_raw("arm", packet, writer.clock.monotonic_ns / 1e9 + i / 8)
        return ["export", str(path), str(tmp_path / f"{name}.csv")]

    assert run(recorded("nan", layout.encode({"values0": [0.5, math.nan]}))) == 0
    lines = (tmp_path / "nan.csv").read_text("utf-8").splitlines()
    assert [line.partition(",")[2] for line in lines[1:]] == ["0.5,nan"] * 3
    assert run(recorded("short", b"short")) == 1
    assert "0 rows, 3 malformed packets skipped" in capsys.readouterr().out


def run(arguments: list[str]) -> int:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    return int(ended.value.code or 0)
