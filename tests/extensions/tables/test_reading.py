"""Cells, names of columns and times of tables in text files."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from conftest import raises_with

from sero_mj.base.errors import CsvError
from sero_mj.extensions.tables.table import read_csv


def read(tmp_path: Path, text: str, rate: float | None = None) -> tuple[list[float], dict]:
    path = tmp_path / "t.csv"
    path.write_text(text, encoding="utf-8")
    times, columns = read_csv(path, rate=rate)
    return times.tolist(), {name: column.tolist() for name, column in columns.items()}


def test_times_come_from_a_column_or_a_rate(tmp_path: Path) -> None:
    table = "\ufefftime, a ,b\n0.0,1,nan\n\n0.5,-2e3,inf\n"
    times, columns = read(tmp_path, table)
    assert times == [0.0, 0.5]
    assert list(columns) == ["a", "b"]
    assert columns["a"] == [1.0, -2000.0]
    assert math.isnan(columns["b"][0]) and columns["b"][1] == math.inf
    assert read(tmp_path, table, rate=4.0)[0] == [0.0, 0.25]
    assert read(tmp_path, "1,2\r\n3,4\r\n", rate=10.0) == (
        [0.0, 0.1],
        {"1": [1.0, 3.0], "2": [2.0, 4.0]},
    )
    assert read(tmp_path, "time\n5\n2\n", rate=1.0) == ([0.0, 1.0], {})


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "has no rows with numbers"),
        ("time,a\n", "has no rows with numbers"),
        ("a,b\n1,2\n", "found the columns a, b; expected a column time in s"),
        ("1,2\n3,4\n", "found the columns 1, 2"),
        ("time,a\n0,1\n1\n", "3: found 1 values; expected 2, one for each column"),
        ("time,a\n0,1\n\n1,x\n", "4: a: found 'x'; expected a number, or nan"),
        ("time,a\n,1\n", "2: time: found nothing; expected times in s that never decrease"),
        ("time,a\n1,1\n0.5,1\n", "3: time: found 0.5 after 1.0"),
        ("time,a\nnan,1\n", "2: time: found nan"),
        ("time,,b\n0,1,2\n", "1: column 2 has no name"),
        ("time,\n0,1\n", "1: column 2 has no name"),
        (",time,,b\n0,0,1,2\n", "1: column 3 has no name"),
        (",time\n0,0,1\n", "2: found 3 values"),
        ("time;a\n0;1.2.3\n", "2: a: found '1.2.3'"),
        ('time,a\n0,"1,5"\n', "2: a: found '1,5'"),
        ('time,a\n0,"1\x00\n', r"2: a: found '1\x00'; expected a number"),
    ],
)
def test_errors_in_a_table_have_line_and_column(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(CsvError) as caught:
        read(tmp_path, text)
    separator = ":" if expected[1] == ":" else " " if expected.startswith("has") else ": "
    assert str(caught.value).startswith(f"{tmp_path / 't.csv'}{separator}{expected}")


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("time,a,b\n0,1,\n0.5,,2.5\n", ["a", "b"]),
        (",time,a,b\n0,0.0,1,\n1,0.5,,2.5\n", ["a", "b"]),  # pandas, with its index
        ("# time,a,b\n0,1,\n0.5,,2.5\n", ["a", "b"]),  # numpy.savetxt
        ("# of a robot; 2 Hz\n#time,a,b\n0,1,\n0.5,,2.5\n# end\n", ["a", "b"]),
        ("time;a;b\n0;1;\n0,5;;2,5\n", ["a", "b"]),
        ("# time;a;b\n0,0;1;\n0,5;;2,5\n", ["a", "b"]),
        ("# two numbers\ntime,a;1,b\n0,1,\n0.5,,2.5\n".replace("a;1", '"a;1"'), ["a;1", "b"]),
    ],
)
def test_tables_of_other_programs_are_read(tmp_path: Path, text: str, names: list[str]) -> None:
    times, columns = read(tmp_path, text)
    assert (times, list(columns)) == ([0.0, 0.5], names)
    np.testing.assert_array_equal(np.array([*columns.values()]), [[1.0, math.nan], [math.nan, 2.5]])


def test_columns_without_names_are_numbered(tmp_path: Path) -> None:
    counted = read(tmp_path, ",0,1\n0,5,6\n1,7,8\n", rate=2.0)  # pandas, of an array
    assert counted == ([0.0, 0.5], {"0": [5.0, 7.0], "1": [6.0, 8.0]})
    plain = read(tmp_path, "# two numbers\n5;6,5\n7;8,5\n", rate=2.0)
    assert plain == ([0.0, 0.5], {"1": [5.0, 7.0], "2": [6.5, 8.5]})


def test_file_that_is_not_a_table_is_rejected(tmp_path: Path) -> None:
    with raises_with(
        CsvError, path=f"{tmp_path}/n.csv", reason="cannot be read: No such file or directory"
    ):
        read_csv(tmp_path / "n.csv")
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00")
    with raises_with(
        CsvError, path=f"{tmp_path}/b.csv", reason="is not text in UTF-8: invalid start byte"
    ):
        read_csv(tmp_path / "b.csv")
    for rate in (0.0, -1.0, math.nan, math.inf):
        with raises_with(
            key="rate", found=rate, expected="a finite number of rows per second above 0"
        ):
            read_csv(tmp_path / "b.csv", rate=rate)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="needs an infinite file")
def test_device_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "table.csv").symlink_to("/dev/zero")
    reason = "cannot be read: found a device; expected a file"
    with raises_with(CsvError, path=f"{tmp_path}/table.csv", reason=reason):
        read_csv(tmp_path / "table.csv")
