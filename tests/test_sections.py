"""The page state in sections: a browser may miss states, but never the last of a section."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from page_client import read_sections

from sero_mj.viewer.web.sections import Sections, message_of


def test_message_has_the_changes_and_the_next_one_nothing() -> None:
    sections = Sections()
    assert sections.since(0) == (None, 0)
    sections.put("time", 1.5)
    poses = np.arange(3, dtype=np.float32)
    sections.put("poses", poses)
    message, seen = sections.since(0)
    assert message is not None
    assert read_sections(message) == {"time": 1.5, "poses": poses.tobytes()}
    assert sections.since(seen) == (None, seen)
    sections.put("time", 1.5)  # unchanged
    assert sections.since(seen) == (None, seen)
    sections.put("time", 2.0)
    sections.put("name", '</script>"\u2028')
    message, _ = sections.since(seen)
    assert message is not None
    assert read_sections(message) == {"time": 2.0, "name": '</script>"\u2028'}


def test_values_that_json_cannot_represent_are_rejected() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        Sections().put("time", float("nan"))


@given(
    st.lists(
        st.tuples(st.sampled_from("abcd"), st.binary(max_size=9) | st.integers() | st.text()),
        max_size=40,
    ),
    st.integers(0, 2**32),
)
def test_occasional_reader_ends_up_with_the_complete_state(
    changes: list[tuple[str, Any]], seed: int
) -> None:
    sections, chance = Sections(), random.Random(seed)
    lookers: list[tuple[dict[str, Any], int]] = [({}, 0) for _ in range(3)]
    expected: dict[str, Any] = {}

    def look(k: int) -> None:
        found, seen = lookers[k]
        message, seen = sections.since(seen)
        if message is not None:
            found.update(read_sections(message))
        lookers[k] = found, seen

    for name, value in changes:
        sections.put(name, value)
        expected[name] = value
        if chance.random() < 0.5:
            look(chance.randrange(3))
    for k in range(3):
        look(k)
        assert lookers[k][0] == expected


def test_message_without_sections_is_valid() -> None:
    assert read_sections(message_of({})) == {}
