"""The words of messages in messages.txt, and what tests assert of errors apart from them."""

from __future__ import annotations

import pytest
from refusals import MESSAGES, facts, states

WRONG = "a.toml:3: arm.size: found -1; expected greater than 0"


def test_each_message_stands_there_once_in_order_without_a_full_stop() -> None:
    lines = MESSAGES.read_text("utf-8").splitlines()
    assert lines == sorted(set(lines))
    assert not [line for line in lines if line.endswith(".") or line != line.strip()]


@pytest.mark.parametrize(
    "expected", ["arm.size: -1, 0", "arm.size: -1", "a.toml:3: arm.size: -1", "found -1; expected"]
)
def test_an_error_states_its_place_key_and_values(expected: str) -> None:
    assert facts(WRONG) == ["a.toml:3: arm.size: -1, 0"]
    states(WRONG, expected)


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (WRONG, ["arm.size: -2"]),
        (WRONG, ["arm.size: -1, 1"]),
        (WRONG, ["arm.siz: -1"]),
        (WRONG, ["size: -1"]),
        (WRONG, ["a.toml:4: arm.size: -1"]),
        (WRONG, []),
        (f"{WRONG}\n{WRONG}", ["arm.size: -1"]),
        (WRONG.replace("greater", "grater"), ["arm.size: -1"]),
    ],
)
def test_another_place_key_value_or_wording_is_found(error: str, expected: list[str]) -> None:
    with pytest.raises(AssertionError):
        states(error, *expected)
