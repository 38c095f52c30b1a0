"""What an expression in a route means: numpy's rules for shapes, and units.

A value is an array, each entry of which is a constant plus multiples of received numbers. It is
computed once, when a scene is read; `Value.compile` makes of it what runs with every packet.

- Entries are picked along the first axis: `udp.vectors0[0]` is the first vector, `[0][2]` its z.
- Operands have one shape, or one of them is a number or can be repeated as in numpy.
- A list puts the numbers of its entries one after the other.
- Matrices go whole: one of several can be picked. All that can be computed with them is another
  unit of length: `udp.matrices0 * mm` and `0.001 * udp.matrices0` scale their positions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..errors import RouteError
from .affine import Affine, Array, Ints, Origin, make_affine
from .syntax import Chain, Join, Minus, Name, Node, Number, Pick
from .units import LENGTH, Exponents, describe

Part = tuple[Origin, Ints, Array]


@dataclass(frozen=True, eq=False)
class Value:
    """An array of constants plus multiples of received numbers.

    Attributes:
        offset: the constants; its shape is the value's.
        dimensions: exponents of the unit of each entry, (*shape, 4).
        parts: of each origin: which of its numbers goes to each entry (-1 for none), and what it
            is multiplied by; arrays of the value's shape.
        sizes: how many numbers each origin has.
        is_frames: whether it is 4 x 4 frames.
    """

    offset: Array
    dimensions: Exponents
    parts: tuple[Part, ...] = ()
    sizes: Mapping[Origin, int] | None = None
    is_frames: bool = False

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the array; () for a number."""
        return self.offset.shape

    @property
    def is_constant(self) -> bool:
        """Whether nothing received is in it."""
        return not self.parts

    def compile(self, count: int) -> Affine:
        """Returns what runs with every packet; a constant number is repeated `count` times."""
        offset = np.broadcast_to(self.offset.ravel(), count).astype(np.float64)
        parts = [(origin, take.ravel(), times.ravel()) for origin, take, times in self.parts]
        return make_affine(offset, parts, dict(self.sizes or {}))


def constant(number: float, dimension: tuple[int, ...] = (0, 0, 0, 0)) -> Value:
    """A number, with the exponents of its unit."""
    return Value(np.array(number, np.float64), np.array(dimension, np.int64))


def numbers_of(origin: Origin, shape: tuple[int, ...], dimensions: Exponents | None) -> Value:
    """All numbers of an event or output.

    Args:
        origin: which.
        shape: of its array.
        dimensions: exponents of their units, (count, 4); None for plain numbers.
    """
    count = int(np.prod(shape))
    if dimensions is None:
        dimensions = np.zeros((count, 4), np.int64)
    part = (origin, np.arange(count).reshape(shape), np.ones(shape))
    is_frames = len(shape) == 3
    return Value(
        np.zeros(shape), dimensions.reshape(*shape, 4), (part,), {origin: count}, is_frames
    )


def evaluate(tree: Node, text: str, names: Mapping[str, Value]) -> Value:
    """Computes what an expression means.

    Args:
        tree: its tree.
        text: its text, for messages.
        names: what every name in it stands for.

    Raises:
        RouteError: points at what has no meaning, and says why.
    """
    with np.errstate(all="ignore"):
        value = _Evaluator(text, names).evaluate(tree)
    if not all(np.isfinite(part).all() for part in (value.offset, *(p[2] for p in value.parts))):
        raise RouteError(text, 0, "expected finite numbers", len(text))
    return value


class _Evaluator:
    def __init__(self, text: str, names: Mapping[str, Value]) -> None:
        self._text = text
        self._names = names

    def evaluate(self, node: Node) -> Value:
        match node:
            case Number():
                return constant(node.value)
            case Name():
                return self._names[node.text]
            case Minus():
                value = self.evaluate(node.of)
                self._not_frames(node.at, "-", value)
                return _scaled(value, np.float64(-1.0))
            case Join():
                return self._join(node)
            case Pick():
                return self._pick(node)
            case Chain():
                return self._chain(node)

    def _chain(self, node: Chain) -> Value:
        value = self.evaluate(node.first)
        for sign, at, following in node.rest:
            other = self.evaluate(following)
            if value.is_frames or other.is_frames:
                value = self._scaled_frames(at, sign, value, other)
                continue
            try:
                shape = np.broadcast_shapes(value.shape, other.shape)
            except ValueError:
                shapes = f"{_amount(value)} and {_amount(other)}"
                reason = f"expected as many on both sides; there are {shapes}"
                raise RouteError(self._text, at, reason) from None
            value, other = _spread(value, shape), _spread(other, shape)
            if sign in "+-":
                value = self._sum(at, sign, value, other)
            else:
                value = self._product(at, sign, value, other)
        return value

    def _sum(self, at: int, sign: str, left: Value, right: Value) -> Value:
        plain = ~left.dimensions.any(axis=-1) | ~right.dimensions.any(axis=-1)
        other = (left.dimensions != right.dimensions).any(axis=-1) & ~plain
        if other.any():
            first = tuple(np.argwhere(other)[0])
            units = [describe(value.dimensions[first]) for value in (left, right)]
            reason = f"expected one unit on both sides; there are {units[0]} and {units[1]}"
            raise RouteError(self._text, at, reason)
        if sign == "-":
            right = _scaled(right, np.float64(-1.0))
        given = left.dimensions.any(axis=-1, keepdims=True)
        return Value(
            left.offset + right.offset,
            np.where(given, left.dimensions, right.dimensions),
            left.parts + right.parts,
            {**(left.sizes or {}), **(right.sizes or {})},
        )

    def _product(self, at: int, sign: str, left: Value, right: Value) -> Value:
        if sign == "/":
            if not right.is_constant:
                raise RouteError(self._text, at, "expected a constant behind it")
            if not right.offset.all():
                raise RouteError(self._text, at, "expected no 0 behind it")
            right = replace(right, offset=1.0 / right.offset, dimensions=-right.dimensions)
        elif not (left.is_constant or right.is_constant):
            reason = "expected a constant on one side: a route adds multiples of what is received"
            raise RouteError(self._text, at, reason)
        if left.is_constant:
            left, right = right, left
        scaled = _scaled(left, right.offset)
        return replace(scaled, dimensions=left.dimensions + right.dimensions)

    def _scaled_frames(self, at: int, sign: str, left: Value, right: Value) -> Value:
        """Frames whose positions are times a number: another unit of length."""
        frames, factor = (right, left) if right.is_frames and sign == "*" else (left, right)
        if sign in "+-" or not factor.is_constant or factor.shape or factor.is_frames:
            reason = "expected nothing but a number or a length beside frames, as in frames * mm"
            raise RouteError(self._text, at, reason)
        size = float(factor.offset)
        if not size > 0.0:
            raise RouteError(self._text, at, f"expected a number above 0 beside it; found {size:g}")
        unit = factor.dimensions if sign == "*" else -factor.dimensions
        positions = frames.dimensions[..., :3, 3, :]
        if unit.any() and (positions.any() or tuple(unit) != LENGTH):
            reason = f"expected a length beside frames; found {describe(unit)}"
            raise RouteError(self._text, at, reason)
        factors = np.ones(frames.shape)
        factors[..., :3, 3] = size if sign == "*" else 1.0 / size
        dimensions = frames.dimensions.copy()
        dimensions[..., :3, 3, :] = positions + unit
        return replace(_scaled(frames, factors), dimensions=dimensions)

    def _join(self, node: Join) -> Value:
        values = [self.evaluate(item) for item in node.items]
        self._not_frames(node.at, "[", *values)
        flat = [_reshaped(value, (value.offset.size,)) for value in values]
        starts = np.cumsum([0, *(len(value.offset) for value in flat)])
        parts: list[Part] = []
        for value, start in zip(flat, starts, strict=False):
            for origin, take, times in value.parts:
                index, factor = np.full(starts[-1], -1), np.zeros(starts[-1])
                index[start : start + len(take)] = take
                factor[start : start + len(take)] = times
                parts.append((origin, index, factor))
        return Value(
            np.concatenate([value.offset for value in flat]),
            np.concatenate([value.dimensions for value in flat]),
            tuple(parts),
            {origin: size for value in flat for origin, size in (value.sizes or {}).items()},
        )

    def _pick(self, node: Pick) -> Value:
        value = self.evaluate(node.of)
        name = self._text[node.of.at : node.bracket].strip()
        if not value.shape:
            raise RouteError(self._text, node.bracket, f"expected none: {name} is a single number")
        if value.is_frames and len(value.shape) == 2:
            raise RouteError(
                self._text, node.bracket, f"expected none: {name} is a frame and goes whole"
            )
        length = value.shape[0]
        many = _amount(value) if len(value.shape) == 1 else f"{length} rows"
        ends = isinstance(node.index, slice)  # a slice may end behind the last one
        for at, number in node.places:
            if not -length <= number < length + ends:
                wanted = f"0 to {length - 1 + ends}, or -1 to {-length} from the end"
                reason = f"expected {wanted}: {name} has {many}"
                raise RouteError(self._text, at, reason, len(str(number)))
        index = np.array(node.index) if isinstance(node.index, tuple) else node.index
        parts = tuple(
            (origin, np.asarray(take[index]), np.asarray(times[index]))
            for origin, take, times in value.parts
        )
        offset, dimensions = np.asarray(value.offset[index]), value.dimensions[index]
        if not offset.size:
            raise RouteError(self._text, node.bracket, "expected a slice with something in it")
        return replace(value, offset=offset, dimensions=dimensions, parts=parts)

    def _not_frames(self, at: int, sign: str, *values: Value) -> None:
        if any(value.is_frames for value in values):
            reason = "expected no frames beside it: these only go whole"
            raise RouteError(self._text, at, reason, len(sign))


def _amount(value: Value) -> str:
    if len(value.shape) > 1:
        return " x ".join(map(str, value.shape)) + " values"
    return "1 value" if value.offset.size == 1 else f"{value.offset.size} values"


def _scaled(value: Value, factor: Array | np.float64) -> Value:
    """The value times constants of its shape."""
    parts = tuple((origin, take, times * factor) for origin, take, times in value.parts)
    return replace(value, offset=np.asarray(value.offset * factor), parts=parts)


def _spread(value: Value, shape: tuple[int, ...]) -> Value:
    """The value repeated to a shape, by numpy's rules."""
    if value.shape == shape:
        return value
    return replace(
        value,
        offset=np.broadcast_to(value.offset, shape),
        dimensions=np.broadcast_to(
            value.dimensions.reshape(
                *(1,) * (len(shape) - len(value.shape)), *value.dimensions.shape
            ),
            (*shape, 4),
        ),
        parts=tuple(
            (origin, np.broadcast_to(take, shape), np.broadcast_to(times, shape))
            for origin, take, times in value.parts
        ),
    )


def _reshaped(value: Value, shape: tuple[int, ...]) -> Value:
    """The same numbers in another shape."""
    return replace(
        value,
        offset=value.offset.reshape(shape),
        dimensions=value.dimensions.reshape(*shape, 4),
        parts=tuple(
            (origin, take.reshape(shape), times.reshape(shape))
            for origin, take, times in value.parts
        ),
    )
