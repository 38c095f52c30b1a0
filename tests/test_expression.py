"""Route expressions: their values against Python and NumPy, and errors."""

from __future__ import annotations

import ast
import time
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from sero_mj.base.errors import RouteError
from sero_mj.data.drive.evaluator import evaluate
from sero_mj.data.drive.language import parse
from sero_mj.data.drive.route import Affine, Origin
from sero_mj.data.drive.units import UNITS
from sero_mj.data.drive.values import Value, constant, numbers_of
from sero_mj.robots.declared.route_text import names_in

Array = NDArray[np.float64]
EVENTS = {
    "udp.values0": (4,),
    "udp.values1": (1,),
    "my-udp.values0": (4,),
    "udp.vectors0": (2, 3),
    "udp.matrices0": (2, 4, 4),
}
ORIGINS = {name: Origin(*name.split("."), True) for name in EVENTS}
NAMES: dict[str, Value] = {
    **{name: numbers_of(ORIGINS[name], shape) for name, shape in EVENTS.items()},
    **{name: constant(*unit) for name, unit in UNITS.items()},
}
DATA = {
    name: np.random.default_rng(k).uniform(-3, 3, shape)
    for k, (name, shape) in enumerate(EVENTS.items())
}


def value_of(text: str) -> Value:
    expression = parse(text)
    return evaluate(expression, {name: NAMES[name] for name in names_in(text)})


def computed(text: str, data: dict[str, Array] = DATA) -> Array:
    """Returns the value from our parser, as evaluated with every packet, flat."""
    value = value_of(text)
    affine: Affine = value.compile(value.entries.size)
    by_origin = {origin: data[name].ravel() for name, origin in ORIGINS.items()}
    with np.errstate(over="ignore", invalid="ignore"):
        return affine.evaluate(by_origin.__getitem__)


class Numpy(ast.NodeTransformer):
    """Lists are concatenated; several numbers in brackets select several rows."""

    def visit_List(self, node: ast.List) -> ast.AST:
        self.generic_visit(node)
        return ast.Call(ast.Name("join", ast.Load()), [node], [])

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        node.value = self.visit(node.value)
        if isinstance(node.slice, ast.Tuple):
            node.slice = ast.List(node.slice.elts, ast.Load())
        return node


def by_python(text: str, data: dict[str, Array] = DATA) -> Array:
    """Returns the value from Python's parser and NumPy, flat."""
    tree = Numpy().visit(ast.parse(text.replace("my-udp", "my_udp").strip(), mode="eval"))
    spaces: dict[str, dict[str, Array]] = {}
    for name, array in data.items():
        source, event = name.replace("-", "_").split(".")
        spaces.setdefault(source, {})[event] = array
    names = {source: SimpleNamespace(**events) for source, events in spaces.items()}
    names |= {name: unit[0] for name, unit in UNITS.items()}
    names["join"] = lambda parts: np.concatenate([np.ravel(part) for part in parts])
    code = compile(ast.fix_missing_locations(tree), "route", "eval")
    with np.errstate(all="ignore"):
        return np.ravel(np.asarray(eval(code, {"__builtins__": {}}, names), np.float64))


@pytest.mark.parametrize(
    "text",
    [
        "udp.values0",
        " udp.values0 ",
        "udp.values0[1:3]",
        "udp.values0[:-1]",
        "udp.values0[::-1]",
        "udp.values0[3:0:-2]",
        "udp.values0[2,0,0,-1]",
        "udp.values0[2,]",
        "udp.values0[ -1 ]",
        "udp.vectors0[1]",
        "udp.vectors0[1][2]",
        "udp.vectors0[1,0]",
        "udp.vectors0[::-1][0][1:]",
        "udp.vectors0 - [1, 2, 3]",
        "-udp.values0",
        "- - + -udp.values0",
        "2 - -udp.values0",
        "0.001 * udp.values0",
        "1e-3*udp.values0",
        "udp.values0 * deg",
        "udp.values0 * mm / s",
        "udp.values0 / 2 / 4",
        "udp.values0 - my-udp.values0 - 1",
        "udp.values0 - (my-udp.values0 - 1)",
        "2 + 3 * udp.values0 * 4 - 5",
        "udp.values0 + [0, 0, 0.1, 0]",
        "[1, -1, 1, -1] * udp.values0",
        "udp.values0 / [1, 2, 3, 4]",
        "[udp.values0[0:2], my-udp.values0[2:4]]",
        "[udp.values0[3], 2 * udp.values0[0], 7, -.5]",
        "[udp.vectors0, udp.values0, udp.values0[0]]",
        "[[1, 2], [3, udp.values1]]",
        "(udp.values0 + my-udp.values0)[1:3] * 2",
        "udp.values0 - udp.values0[1]",
        "udp.values0 + udp.values1",
        "udp.values1 * [1, 2, 3]",
        "[1, 2, 3][1]",
        "90 * deg",
        "0 * udp.values0",
        "udp.values0 - udp.values0",
        "3 * kN * m / (2 * Nm)",
    ],
)
def test_expression_equals_the_numpy_result(text: str) -> None:
    np.testing.assert_allclose(computed(text), by_python(text), rtol=1e-13, atol=1e-13)


NUMBERS = st.sampled_from(["2", "0.5", "-3", "1e-3", "0", "7.25", "deg", "mm", "(1 - 3)"])
FACTORS = st.sampled_from(["2", "0.5", "-3", "deg", "[1, -1, 2, 4]", "(2 * cm)", "0"])
DIVISORS = st.sampled_from(["2", "-4", "[1, 2, -4, 8]", "(1 / 3)"])
PICKS = st.sampled_from(["[::-1]", "[3,2,0,1]", "[0,0,-1,2]", "[:]", "[0:4]"])
FOURS = st.recursive(
    st.sampled_from(["udp.values0", "my-udp.values0", "[1, 2, 3, 4]", "[0, udp.vectors0[1]]"]),
    lambda four: st.one_of(
        st.tuples(four, st.sampled_from([" + ", " - "]), four).map("({0[0]}{0[1]}{0[2]})".format),
        st.tuples(FACTORS, four).map("{0[0]} * {0[1]}".format),
        st.tuples(four, FACTORS).map("({0[0]}) * {0[1]}".format),
        st.tuples(four, DIVISORS).map("({0[0]}) / {0[1]}".format),
        st.tuples(four, PICKS).map("({0[0]}){0[1]}".format),
        st.tuples(four, four).map("[({0[0]})[2:], ({0[1]})[:2]]".format),
        st.tuples(four, four).map("({0[0]}) + ({0[1]})[1]".format),
        four.map("-({})".format),
    ),
    max_leaves=8,
)
ENTRIES = st.one_of(st.floats(-1e3, 1e3, allow_subnormal=False), st.just(np.nan))


@settings(deadline=None, max_examples=examples(200))
@given(FOURS, arrays(np.float64, 4, elements=ENTRIES), arrays(np.float64, 4, elements=ENTRIES))
def test_any_expression_equals_the_numpy_result(text: str, one: Array, two: Array) -> None:
    data = {**DATA, "udp.values0": one, "my-udp.values0": two}
    plain = text.replace("deg", "0.0174532925199433").replace("mm", "0.001").replace("cm", "0.01")
    expected = by_python(text, data)
    # Sums may cancel: the rounding error is small beside the largest intermediate value.
    size = 1e3 * 4.0 ** text.count("*") * 2.0 ** text.count("+")
    np.testing.assert_allclose(computed(plain, data), expected, rtol=1e-9, atol=1e-13 * size)


WORDS = ["udp.values0", "my-udp.values0", "udp.vectors0", "udp.matrices0", "deg", "mm", "not"]
WORDS += [*"+-*/()[],:", "0", "1", "2", "1.5", "1e308", "$", " ", " "]


@settings(deadline=None)
@given(st.lists(st.sampled_from(WORDS), max_size=14).map(" ".join))
def test_any_text_is_evaluated_or_rejected(text: str) -> None:
    try:
        value = value_of(text)
    except RouteError as error:
        assert 0 <= error.position <= len(text)
        assert error.text == text
    else:
        assert np.isfinite(value.compile(value.entries.size).offset).all()


@pytest.mark.parametrize(
    "text", ["udp.values0", "udp.values0[::-1] * 2 + 1", "udp.values0 - my-udp.values0[0]"]
)
def test_values_over_time_equal_the_values_at_each_time(text: str) -> None:
    random = np.random.default_rng(2)
    times = {origin: random.normal(size=(5, 4)) for origin in ORIGINS.values()}
    affine = value_of(text).compile(4)
    rows = [affine.evaluate(lambda o, k=k: times[o][k]) for k in range(5)]  # type: ignore[misc]
    np.testing.assert_array_equal(affine.evaluate(times.__getitem__), rows)


@pytest.mark.parametrize(
    "text",
    ["- " * 1900 + "udp.values0", " + ".join(["udp.values0"] * 1000), "udp.values0" + " * 1" * 900],
)
def test_long_expressions_are_compiled_quickly(text: str) -> None:
    begin = time.process_time()
    expected = DATA["udp.values0"] * (text.count("+") + 1)
    np.testing.assert_allclose(computed(text), expected, rtol=1e-12)
    assert time.process_time() - begin < 2.0


@pytest.mark.parametrize(
    "text", ["udp.values0", "udp.values0[0:4]", "[udp.values0]", "1 * udp.values0"]
)
def test_identity_expressions_are_compiled_to_a_copy(text: str) -> None:
    assert value_of(text).compile(4).whole == ORIGINS["udp.values0"]


@pytest.mark.parametrize("text", ["udp.values0[::-1]", "udp.values0[0:3]", "-udp.values0"])
def test_expressions_that_change_values_are_not_a_copy(text: str) -> None:
    value = value_of(text)
    assert value.compile(value.entries.size).whole is None


def test_slices_of_one_event_are_merged_into_one_term() -> None:
    affine = value_of("[udp.values0[3], 0, -udp.values0[1], udp.values0[0], 1]").compile(5)
    (term,) = affine.terms
    assert term.take.tolist() == [3, 1, 0]
    assert term.times.tolist() == [1.0, -1.0, 1.0]
    assert affine.offset.tolist() == [0.0, 0.0, 0.0, 0.0, 1.0]


def test_copied_values_are_identical_bit_for_bit() -> None:
    bits = np.array([-0.0, 5e-324, 0.1, np.nan])
    found = computed("udp.values0[3,2,1,0]", {**DATA, "udp.values0": bits})
    assert found.tobytes() == bits[::-1].tobytes()


def test_infinity_minus_infinity_raises_no_warning() -> None:
    huge = {**DATA, "udp.values0": np.full(4, 1e300)}
    assert np.isnan(computed("udp.values0 * 1e10 - udp.values0 * 1e10", huge)).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "character 1: found the end, expected an event such as udp.values0, a number, ( or ["),
        ("udp.values0 +", "character 14: found the end, expected an event such as"),
        ("udp.values0 * )", "character 15: found ')', expected an event such as"),
        ("udp.values0 )", "character 13: found ')', expected +, -, * or / between spaces, or the"),
        ("90 deg", "character 4: found 'deg', expected +, -, * or / between spaces before it"),
        ("(udp.values0", "character 13: found the end, expected +, -, * or / between spaces, or )"),
        ("[1, 2", "character 6: found the end, expected , or ]"),
        ("[1, 2)", "character 6: found ')', expected , or ]"),
        ("[]", "character 2: found ']', expected an event such as"),
        ("1 $ 2", "character 3: found '$', expected +, -, * or / between spaces, or the end"),
        ("not not 1", "character 5: found 'not', expected an event such as udp.values0, a number, "
         "( or [; 'not' must be the first word"),
        ("1e999", "character 1: found '1e999', expected a smaller number"),
        ("1e308 * 1e308", "character 1: found '1e308 * 1e308', expected finite numbers"),
        ("(" * 41 + "1", "character 41: found '(', expected at most 40 nested brackets"),
        ("udp.values0[4]", "character 13: found '4', expected 0 to 3, or -1 to -4 from the end: "
         "udp.values0 has 4 values"),
        ("udp.values0[0,-5]", "character 15: found '-5', expected 0 to 3, or"),
        ("udp.values0[0:5]", "character 15: found '5', expected 0 to 4, or -1 to -4 from the end"),
        ("udp.vectors0[2]", "character 14: found '2', expected 0 to 1, or -1 to -2 from the end: "
         "udp.vectors0 has 2 rows"),
        ("udp.vectors0[0][3]", "character 17: found '3', expected 0 to 2, or"),
        ("udp.values0[2:2]", "character 12: found '[', the slice is empty"),
        ("udp.values0[::0]", "character 15: found '0', expected a step other than 0"),
        ("udp.values0[]", "character 13: found ']', expected a whole number or a slice such as"),
        ("udp.values0[1.5]", "character 13: found '1.5', expected a whole number"),
        ("udp.values0[0;2]", "character 14: found ';', expected : , or ]"),
        ("udp.values0[0,x]", "character 15: found 'x', expected a whole number"),
        ("udp.values0[0][0]", "character 15: found '[', udp.values0[0] is a single number"),
        ("udp.values0 + [1, 2]", "character 13: found '+', expected equal sizes on both "
         "sides; found 4 values and 2 values"),
        ("udp.values0 - udp.vectors0", "found 4 values and 2 x 3 values"),
        ("udp.values0 * my-udp.values0", "character 13: found '*', expected a constant on one "
         "side: routes can only add multiples of numbers"),
        ("2 / udp.values0", "character 3: found '/', expected a constant divisor"),
        ("udp.values0 / [1, 0, 1, 1]", "character 13: found '/', expected a divisor other than 0"),
        ("udp.values0 * deg + 3 * mm", "character 19: found '+', expected the same unit on both "
         "sides; found an angle (rad) and a length (m)"),
        ("[1 * deg, 2 * mm] - [1 * deg, 2 * N]", "found a length (m) and a force (N)"),
        ("udp.matrices0 + 2", "character 15: found '+', frames can only be multiplied by a number "
         "or a length, as in frames * mm"),
        ("udp.matrices0 * [1, 2]", "found '*', frames can only be multiplied by a number"),
        ("2 / udp.matrices0", "found '/', frames can only be multiplied by a number or a length"),
        ("udp.matrices0 * udp.matrices0", "frames can only be multiplied by a number or a length"),
        ("udp.values0 * udp.matrices0", "frames can only be multiplied by a number or a length"),
        ("udp.matrices0 * deg", "character 15: found '*', expected a length as the factor of "
         "frames; found an angle (rad)"),
        ("udp.matrices0 * mm * mm", "character 20: found '*', expected a length as the factor"),
        ("udp.matrices0 / mm", "character 15: found '/', expected a length as the factor"),
        ("-1 * udp.matrices0", "character 4: found '*', expected a factor above 0; "
         "found -1"),
        ("udp.matrices0 * 0", "expected a factor above 0; found 0"),
        ("-udp.matrices0", "character 1: found '-', frames cannot be indexed or combined"),
        ("[udp.matrices0]", "character 1: found '[', frames cannot be indexed or combined"),
        ("udp.matrices0[0][1]", "character 17: found '[', udp.matrices0[0] is a "
         "frame, which cannot be indexed"),
    ],
)  # fmt: skip
def test_error_points_to_its_position(text: str, message: str) -> None:
    with pytest.raises(RouteError) as caught:
        value_of(text)
    assert str(caught.value).startswith(f"'{text}', character ")
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("text", "dimension"),
    [
        ("udp.values0", (0, 0, 0, 0)),
        ("udp.values0 * deg", (0, 0, 0, 1)),
        ("2 * udp.values0 / s * mm", (1, 0, -1, 0)),
        ("udp.values0 + 3 * deg", (0, 0, 0, 1)),
        ("3 * deg - udp.values0", (0, 0, 0, 1)),
        ("udp.values0 * N * m", (2, 1, -2, 0)),
        ("udp.values0 * Nm", (2, 1, -2, 0)),
        ("udp.values0 * deg * (5 * Nm / rad)", (2, 1, -2, 0)),
        ("(udp.values0 * deg) / deg", (0, 0, 0, 0)),
        ("-(udp.values0 * kg)[1:]", (0, 1, 0, 0)),
        ("rpm", (0, 0, -1, 1)),
    ],
)
def test_units_are_multiplied(text: str, dimension: tuple[int, ...]) -> None:
    value = value_of(text)
    assert set(value.units) == {dimension}
    assert len(value.units) == value.entries.size


def test_every_entry_has_its_own_unit() -> None:
    value = value_of("[udp.values0[0] * deg, 3 * mm, 1] * [1, N, 2]")
    assert value.units == [(0, 0, 0, 1), (2, 1, -2, 0), (0, 0, 0, 0)]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("udp.values0 * 2", "[-0.0, 0.0, 2.0, -2.0]"),
        ("udp.values0 * deg", None),
        ("-udp.values0", "[0.0, -0.0, -1.0, 1.0]"),
        ("[udp.values0[0] * 2, 0, udp.values0[1], udp.values0[0] + 0]", "[-0.0, 0.0, 0.0, -0.0]"),
        ("udp.values0 - udp.values0", "[0.0, 0.0, 0.0, 0.0]"),
        ("udp.values0 + 1", "[1.0, 1.0, 2.0, 0.0]"),
    ],
)
def test_zero_keeps_its_sign(text: str, expected: str | None) -> None:
    numbers = np.array([-0.0, 0.0, 1.0, -1.0])
    found = value_of(text).compile(4).evaluate(lambda _: numbers)
    if expected is None:
        assert np.signbit(found).tolist() == [True, False, False, True]
    else:
        assert str(found.tolist()) == expected
