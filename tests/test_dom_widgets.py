"""Panels as trees of nodes: building them, and returning user input to the widget's caller."""

from __future__ import annotations

import json
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sero_mj.viewer.panels.dom_widgets import DomWidgets
from sero_mj.viewer.session.widgets import Plot, PlotLine, Widgets

SIZE = (20.0, 10.0)


@pytest.fixture
def ui() -> DomWidgets:
    return DomWidgets(lambda text: None)


def test_dom_widgets_implement_the_widgets_protocol(ui: DomWidgets) -> None:
    widgets: Widgets = ui  # as mypy checks it
    assert widgets is ui


def test_sections_nodes_and_tables_contain_the_widgets_built_inside(ui: DomWidgets) -> None:
    def build() -> None:
        if ui.header("One", is_open=True):
            ui.text("in one", "bad")
            if ui.tree("inner"):
                raise AssertionError("it is folded")
        if ui.header("Two"):
            raise AssertionError("it is folded")
        if ui.header("Three###third", is_open=True) and ui.table("##t", (0, 3.5)):
            for name in "ab":
                ui.row()
                ui.cell()
                ui.label(name)
                ui.cell()
                ui.button(f"go##{name}")
            ui.end_table()
            ui.text("behind the table")

    one, two, three = ui.tree_of(build, SIZE)
    assert (one["k"], one["s"], one["open"]) == ("header", "One", True)
    assert one["nodes"][0] == {"k": "text", "s": "in one", "mood": "bad"}
    assert (one["nodes"][1]["k"], one["nodes"][1]["open"]) == ("tree", False)
    assert (two["open"], two["nodes"]) == (False, [])
    assert (three["s"], three["id"]) == ("Three", "third")
    table, text = three["nodes"]
    assert [[cell[0]["k"] for cell in row] for row in table["rows"]] == [["label", "button"]] * 2
    assert table["widths"] == [0, 3.5]
    assert text["s"] == "behind the table"
    ui.fold("Two", is_open=True)
    ui.fold("One", is_open=False)
    opened = []

    def build_again() -> None:
        opened.extend([ui.header("One", is_open=True), ui.header("Two")])

    ui.tree_of(build_again, SIZE)
    assert opened == [False, True]


def test_user_input_is_returned_once_and_by_its_widget_only(ui: DomWidgets) -> None:
    found: list[Any] = []

    def build() -> None:
        ui.tree("robot")
        ui.scope("s")
        found.append(
            (
                ui.button("go"),
                ui.button("go"),
                ui.check("on", is_on=False),
                ui.choose("##kind", 0, ["a", "b"]),
                ui.slide("q", 1.0, -2.0, 2.0, "%.1f deg"),
                ui.number("n", 0.5, "x %.2f"),
                ui.search("find", "", "search"),
                ui.select("A1", is_lit=True),
            )
        )
        ui.end_scope()
        ui.end_tree()

    ui.tree_of(lambda: ui.tree("robot"), SIZE)
    ui.fold("robot", is_open=True)
    nodes = ui.tree_of(build, SIZE)[0]["nodes"]
    nothing = (False, False, (False, False), (False, 0), (False, 1.0), (False, 0.5), "", False)
    assert found == [nothing]
    ids = [node["id"] for node in nodes]
    assert len(set(ids)) == len(ids)  # even of two with the same label
    assert [node.get("text") for node in nodes[4:6]] == ["1.0 deg", "x 0.50"]
    assert nodes[3]["aria"] == "kind"
    for id_, value in zip(ids[1:], [True, True, 1, 9.0, -3, "A", True], strict=True):
        ui.act(id_, value)
    ui.tree_of(build, SIZE)
    assert found[1] == (False, True, (True, True), (True, 1), (True, 2.0), (True, -3.0), "A", True)
    ui.tree_of(build, SIZE)
    assert found[2] == nothing


def test_disabled_widgets_take_no_input(ui: DomWidgets) -> None:
    def build() -> bool:
        ui.disable(is_off=True)
        ui.disable(is_off=False)
        pressed = ui.button("go")
        ui.enable()
        ui.enable()
        return pressed

    pressed: list[bool] = []
    ui.tree_of(build, SIZE)
    ui.act("go", True)
    (node,) = ui.tree_of(lambda: pressed.append(build()), SIZE)
    assert (node["off"], pressed) == (True, [False])


def test_input_of_a_removed_widget_is_not_returned_when_it_reappears(ui: DomWidgets) -> None:
    ui.tree_of(lambda: ui.button("go"), SIZE)
    ui.act("go", True)
    ui.tree_of(lambda: ui.text("nothing else"), SIZE)
    pressed: list[bool] = []
    ui.tree_of(lambda: pressed.append(ui.button("go")), SIZE)
    assert pressed == [False]


def test_unknown_widget_ids_are_not_stored(ui: DomWidgets) -> None:
    def build() -> None:
        if ui.header("Section", is_open=True) and ui.tree("node"):
            ui.end_tree()
        ui.button("go")

    ui.tree_of(build, SIZE)
    size = len(pickle.dumps(vars(ui) | {"copy": None}))
    for k in range(100):
        ui.act(f"x{k}", True)
        ui.fold(f"x{k}", is_open=True)
        ui.act("Section", True)  # it is no widget
        ui.fold("go", is_open=True)  # it cannot be folded
    assert len(pickle.dumps(vars(ui) | {"copy": None})) == size
    assert ui.folds == {}
    ui.fold("Section", is_open=False)
    assert ui.folds == {"Section": False}


def test_positions_and_tooltips_apply_to_the_right_widgets(ui: DomWidgets) -> None:
    def build() -> None:
        ui.width(0.0)
        ui.button("a", 3.0)
        ui.same_line(left=9.0)
        ui.text("b")
        ui.tip("about b")
        ui.same_line(gap=2.0)
        ui.label("c")

    a, b, c = ui.tree_of(build, SIZE)
    assert a["width"] == 3.0
    assert "same" not in a
    assert (b["same"], b["left"], b["tip"]) == (-1.0, 9.0, "about b")
    assert (c["same"], "tip" in c) == (2.0, False)
    assert ui.room()[0] == SIZE[0]


def test_widgets_reduce_the_space_for_following_ones(ui: DomWidgets) -> None:
    line = PlotLine("msr", (1.0, 0.5, 0.0), np.zeros(2), np.zeros(2))
    plot, left = Plot("s", "torque [Nm]", [line], (-8.0, 0.0), (-1.0, 1.0), ()), list[float]()

    def build() -> None:
        left.append(ui.room()[1])
        ui.choose("##joint", 0, ["A1", "A2"])
        ui.same_line()
        ui.label("limit 176 Nm")
        left.append(ui.room()[1])
        ui.plot(plot, 9.0)
        left.append(ui.room()[1])
        for _ in range(100):
            ui.text("more than there is room for")
        left.append(ui.room()[1])

    ui.tree_of(build, (30.0, 24.0))
    assert left[0] == 24.0 and left[3] == 0.0
    assert 2 <= left[0] - left[1] < 3  # of the text's height, for two widgets in one line
    assert 9 <= left[1] - left[2] < 10


def test_plots_have_gaps_and_only_finite_limits(ui: DomWidgets) -> None:
    line = PlotLine("msr", (1.0, 0.5, 0.0), np.array([0.0, 0.123456789]), np.array([np.nan, -1e-9]))
    plot = Plot("s", "torque [Nm]", [line], (-20.0, 0.0), (-1.0, 1.0), (np.inf, -np.inf))
    (node,) = ui.tree_of(lambda: ui.plot(plot, 8.0), SIZE)
    assert node["limits"] == []
    assert node["lines"][0] == {
        "name": "msr", "rgb": (1.0, 0.5, 0.0), "x": [0.0, 0.12346], "y": [None, -1e-9],
    }  # fmt: skip
    assert node["height"] == 8.0
    json.dumps(node, allow_nan=False)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=5,
)


@given(value=JSON)
def test_widgets_return_valid_values_for_any_browser_input(value: Any) -> None:
    ui = DomWidgets(lambda text: None)
    found: list[Any] = []

    def build() -> None:
        found.extend([
            ui.check("check", is_on=True), ui.choose("choose", 1, ["a", "b"]),
            ui.slide("slide", 0.0, -1.0, 1.0, ""), ui.number("number", 0.0, "%.1f"),
            ui.search("search", "x", ""), ui.button("button"),
        ])  # fmt: skip

    for label in ("check", "choose", "slide", "number", "search", "button"):
        ui.act(label, value)
    nodes = ui.tree_of(build, SIZE)
    json.dumps(nodes, allow_nan=False)
    (_, is_on), (_, index), (_, slid), (_, typed), text, pressed = found
    assert isinstance(is_on, bool)
    assert index in (0, 1)
    assert -1.0 <= slid <= 1.0
    assert np.isfinite(typed)
    assert isinstance(text, str)
    assert isinstance(pressed, bool)
