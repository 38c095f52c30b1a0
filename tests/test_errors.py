"""Values in messages are shown in TOML syntax, regardless of their type in Python."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sero_mj.base.errors import reason_of, shown

_plain = st.none() | st.booleans() | st.integers() | st.floats() | st.text("xyz")
_nested = st.recursive(
    _plain | st.binary() | st.dates() | st.just(object()) | st.just(np.eye(2)) | st.just(dict),
    lambda each: (
        st.lists(each, max_size=9) | st.dictionaries(st.text(max_size=3), each, max_size=9)
    ),
)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (True, "true"),
        (None, "nothing"),
        (0.1 + 0.2, "0.3"),
        (float("nan"), "nan"),
        ("a", "'a'"),
        ([True, {"a": 1, "b": None}], "[true, {a = 1, b = nothing}]"),
        (np.array([[1.0, 2.5]]), "[[1, 2.5]]"),
        (np.float32(0.5), "0.5"),
        (list(range(100)), "[0, 1, 2, 3, 4, 5, ...]"),
        ([[[[1]]]], "[[[[...]]]]"),
        (datetime.date(2026, 1, 2), "2026-01-02"),
        (b"\x00\x01", "2 bytes"),
        (Path("a/b"), "'a/b'"),
        (Path, "the class Path"),
        (object(), "an object of object"),
    ],
)
def test_values_are_shown_as_in_toml(value: Any, text: str) -> None:
    assert shown(value) == text


@given(_nested)
def test_messages_are_short_and_contain_no_python_repr(value: Any) -> None:
    text = shown(value)
    assert len(text) < 20_000
    assert not any(each in text for each in ("array(", "<class", "<object", "datetime", "b'"))


def test_missing_key_is_described_in_words() -> None:
    assert reason_of(KeyError("topic")) == "has no 'topic'"
    assert reason_of(FileNotFoundError(2, "No such file", "x")) == "No such file"
