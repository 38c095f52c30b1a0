"""Does what a route computes fit the input that it leads to, in number and unit?"""

from __future__ import annotations

from ..assemble.inputs import Input
from .expression import Value
from .units import Exponents, describe


def misfit(value: Value, text: str, item: Input, taken: Exponents) -> str:
    """Says why a value does not fit an input; empty when it does.

    Args:
        value: what the route computes.
        text: its expression.
        item: the input.
        taken: the exponents of the input's units, (count, 4); zero takes any.
    """
    return _wrong_shape(value, text, item) or _wrong_unit(value, text, item, taken)


def _wrong_shape(value: Value, text: str, item: Input) -> str:
    count, shape = value.offset.size, value.shape
    many = "1 value" if count == 1 else f"{count} values"
    if item.shape == (4, 4):
        if value.is_frames and count == 16:
            return ""
        found = f"has {many}" if len(shape) < 2 else f"is {' x '.join(map(str, shape))}"
        return f"{text} {found}; {item.target} takes {item.meaning}: 1M in the structure"
    if value.is_constant and not shape:
        return ""  # one number for all
    if count != item.count:
        return f"{text} has {many}; {item.target} takes {item.meaning}"
    if value.is_frames:
        return f"{text} is a 4 x 4 frame; {item.target} takes {item.meaning}"
    return ""


def _wrong_unit(value: Value, text: str, item: Input, taken: Exponents) -> str:
    found = value.dimensions.reshape(-1, 4)
    for i, want in enumerate(taken):
        have = found[i if len(found) > 1 else 0]
        if have.any() and want.any() and (have != want).any():
            where = ""
            if (found != found[0]).any() or (taken != taken[0]).any():
                where = f" at number {i}, counted from 0"
            return f"{text} is {describe(have)}; {item.target} takes {describe(want)}{where}"
    return ""
