"""Widgets of a program: their display, changes by users, and errors."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from page_client import PageClient
from polling import until
from scripted_widgets import ScriptedWidgets
from shown import Shown
from window_tools import MISSING as NO_WINDOW
from window_tools import screen

import sero_mj
from sero_mj import Mirror, Scene, SerialRobot
from sero_mj.base.errors import RenderError, SeroError, UsageError
from sero_mj.viewer.panels.user_widgets import TOOL
from sero_mj.viewer.program.outbox import Outbox
from sero_mj.viewer.program.panels import UserPanels
from sero_mj.viewer.tools.user_panels import UserPanelsTool
from sero_mj.viewer.web.host import WebHost


class Both:
    """A program and its view; the test delivers their messages."""

    def __init__(self) -> None:
        self.is_open = True
        self.outbox = Outbox(lambda tool, message: True)
        self.outbox.add = self._add  # type: ignore[method-assign]
        self.panels = UserPanels(self.outbox, lambda: self.is_open)
        self.shown = Shown(Mirror(Scene(robots=[SerialRobot.from_model("lwr")])))
        self.tool = UserPanelsTool(self.shown)

    def _add(self, tool: str, take: Callable[[], Any]) -> None:
        assert tool == TOOL
        self.take = take

    def to_view(self) -> None:
        message = self.take()
        if message is not None:
            self.tool.receive(message)

    def to_program(self) -> None:
        answer = self.tool.reply()
        if answer is not None:
            self.panels.receive(answer)

    def use(self, **does: Any) -> ScriptedWidgets:
        """Lets the user of the view act, and delivers the messages to the program."""
        ui = ScriptedWidgets({label.replace("_", " "): value for label, value in does.items()})
        self.tool.build(ui)
        self.to_program()
        return ui


def test_user_sets_the_value_and_sync_calls_back_once() -> None:
    both, calls = Both(), []
    panel = both.panels.panel("Tuning")
    stiffness = panel.slider("stiffness", 0, 2000, value=500, on_change=calls.append)
    mass = panel.number("mass", value=1.5, low=0.0, on_change=calls.append)
    log = panel.check("log", on_change=calls.append)
    law = panel.choice("law", ["impedance", "gravity"], on_change=calls.append)
    reset = panel.button("reset", on_click=lambda: calls.append("reset"))
    text = panel.text("idle")
    assert (stiffness.value, mass.value, log.value, law.value) == (500.0, 1.5, False, "impedance")
    assert (reset.value, text.value) == (0, "idle")
    both.to_view()
    assert both.shown.shows_panel  # it is opened for its contents
    built = both.use().built
    assert built == [
        ("header", "Tuning"),
        *(("slide", "stiffness"), ("number", "mass"), ("check", "log"), ("choose", "law")),
        *(("button", "reset"), ("text", "idle")),
    ]
    both.panels.call()
    assert calls == []
    for value in (600.0, 700.0, 0.1 + 1e-9):  # a float32
        both.use(stiffness=value)
    both.use(mass=2.0, log=True, law="gravity", reset=True)
    both.use(reset=True)
    assert stiffness.value == 0.1
    assert (mass.value, log.value, law.value, reset.value) == (2.0, True, "gravity", 2)
    assert calls == [] and both.panels.has_changes
    both.panels.call()
    assert calls == [0.1, 2.0, True, "gravity", "reset", "reset"]
    both.panels.call()
    assert len(calls) == 6 and not both.panels.has_changes


def test_program_sets_the_value_and_overrides_earlier_user_input() -> None:
    both, calls = Both(), []
    panel = both.panels.panel("Tuning")
    gain = panel.slider("gain", 0, 10, on_change=calls.append)
    text = panel.text("idle")
    both.to_view()
    gain.value, text.value = np.float32(3), "moves"  # type: ignore[assignment]
    both.use(gain=9.0)  # sent before the value arrived
    assert gain.value == 3.0
    both.to_view()
    ui = both.use()
    assert ui.texts() == ["moves"]
    both.panels.call()
    assert calls == []
    both.use(gain=4.0)
    assert gain.value == 4.0


def test_panels_are_in_order_and_can_be_cleared_and_refilled() -> None:
    both = Both()
    first, second = both.panels.panel("first"), both.panels.panel("second")
    second.button("b")
    first.button("a")
    kept = first.button("c")
    assert both.panels.panel("first") is first
    both.to_view()
    both.use(c=True)
    first.clear()
    first.button("c")
    first.button("a")
    both.to_view()
    kept.value = 9  # of a widget that is gone
    both.to_view()
    labels = [label for _, label in both.use(c=True).built]
    assert labels == ["second", "b", "first", "c", "a"]
    both.panels.call()
    assert kept.value == 9


def test_typed_numbers_out_of_range_are_rejected_with_the_range() -> None:
    both = Both()
    panel = both.panels.panel("Tuning")
    mass = panel.number("mass", value=1.0, low=0.0)
    force = panel.number("force", low=-5.0, high=5.0, unit="%N")
    gain = panel.slider("gain", 0, 1)
    both.to_view()
    both.use(mass=-1.0, force=float("nan"), gain=7.0)
    assert (mass.value, force.value, gain.value) == (1.0, 0.0, 1.0)
    said = [text for text, is_bad in both.shown.said if is_bad]
    assert said == [
        "mass: found -1; expected at least 0",
        "force: found nan; expected a finite number",
    ]


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda p: p.slider("k", 5, 5), "k: found the range 5 to 5; expected low < high"),
        (lambda p: p.slider("k", 0, "many"), "k: found 'many'; expected a finite number"),
        (lambda p: p.slider("k", 0, 1, value=2), "k: found 2; expected 0 to 1"),
        (lambda p: p.number("k", value=3, high=2), "k: found 3; expected at most 2"),
        (lambda p: p.number("k", value=[1, 2]), "k: found [1, 2]; expected a finite number"),
        (lambda p: p.check("k", value="yes"), "k: found 'yes'; expected True or False"),
        (lambda p: p.choice("k", []), "k: found the names []; expected different names"),
        (lambda p: p.choice("k", ["a", "a"]), "k: found the names ['a', 'a']; expected different"),
        (lambda p: p.choice("k", ["a", 5]), "k: names: found 5; expected a text without '##'"),
        (lambda p: p.choice("k", ["gravity"], value="gravty"), "found 'gravty'; did you mean 'gra"),
        (lambda p: p.button(""), "label: found ''; expected a text without '##'"),
        (lambda p: p.button("a##b"), "label: found 'a##b'; expected a text without '##'"),
        (lambda p: p.button("old"), "old: the panel 'Tuning' already has a widget"),
        (lambda p: p.button("k", on_click=5), "k: on_click: found 5; expected a function"),
        (lambda p: p.check("k", on_change="f"), "k: on_change: found 'f'; expected a function"),
    ],
)
def test_invalid_widgets_are_rejected(act: Callable[[Any], Any], message: str) -> None:
    both = Both()
    panel = both.panels.panel("Tuning")
    handle = panel.button("old")
    with pytest.raises(UsageError) as caught:
        act(panel)
    assert message in str(caught.value)
    with pytest.raises(UsageError, match="old: found 'x'; expected a number of presses"):
        handle.value = "x"  # type: ignore[assignment]


def test_closed_viewer_rejects_new_widgets_and_the_loop_continues() -> None:
    both = Both()
    panel = both.panels.panel("Tuning")
    gain = panel.slider("gain", 0, 1)
    both.is_open = False
    gain.value = 0.5
    assert gain.value == 0.5
    with pytest.raises(RenderError, match="reset: cannot add a widget: the viewer is closed"):
        panel.button("reset")
    with pytest.raises(RenderError, match="panel 'More': the viewer is closed"):
        both.panels.panel("More")
    with pytest.raises(UsageError, match="panel: found nothing; expected a text"):
        both.panels.panel(None)  # type: ignore[arg-type]
    both.is_open = True


def test_failing_callback_is_not_called_again_and_the_others_are() -> None:
    both, calls = Both(), []
    panel = both.panels.panel("Tuning")

    def fail(value: float) -> None:
        raise ValueError(value)

    panel.slider("bad", 0, 1, on_change=fail)
    panel.slider("good", 0, 1, on_change=calls.append)
    both.to_view()
    both.use(bad=1.0, good=0.5)
    with pytest.raises(ValueError, match=r"1\.0"):
        both.panels.call()
    both.panels.call()
    assert calls == [0.5]


def test_outbox_never_blocks_and_sends_the_latest_value() -> None:
    sent, is_free, values = [], threading.Event(), [0]

    def send(tool: str, message: Any) -> bool:
        sent.append(message)
        is_free.wait(20)
        return True

    outbox = Outbox(send)
    outbox.add("tool", lambda: values[-1])
    begin = time.monotonic()
    for k in range(1000):
        values.append(k)
        outbox.wake()
    assert time.monotonic() - begin < 1.0
    assert until(lambda: sent, 20)
    values.append(5000)
    outbox.wake()
    is_free.set()
    assert until(lambda: sent[-1] == 5000, 20)
    assert len(sent) < 10
    outbox.close()


def test_widgets_work_on_a_page(home: None) -> None:
    both = Both()
    panel = both.panels.panel("Tuning")
    gain = panel.slider("gain", 0, 10, value=5, unit="%")
    law = panel.choice("law", ["impedance", "gravity"])
    reset = panel.button("reset")
    text = panel.text("<b>idle</b>")
    with WebHost(both.shown.mirror) as page, PageClient(page) as client:
        tool = page.tools[TOOL]
        assert isinstance(tool, UserPanelsTool)
        both.tool = tool
        both.to_view()
        client.until(lambda: "Tuning" in str(client.state.get("panel")))
        nodes = client.widget("panel", "Tuning")["nodes"]
        assert [node["k"] for node in nodes] == ["slide", "choose", "button", "text"]
        assert nodes[0]["text"] == "5 %" and nodes[-1]["s"] == "<b>idle</b>"
        for node, value in zip(nodes, (7.5, 1, True), strict=False):
            client.say("widget", tree="panel", id=node["id"], value=value)

        def is_heard() -> bool:
            both.to_program()
            return (gain.value, law.value, reset.value) == (7.5, "gravity", 1)

        client.until(is_heard)
        text.value, gain.value = "moves", 2.0
        both.to_view()
        client.until(lambda: client.widget("panel", "Tuning")["nodes"][-1]["s"] == "moves")
        assert client.widget("panel", "gain")["value"] == 2.0


@pytest.mark.thorough
@pytest.mark.gl
@pytest.mark.skipif(bool(NO_WINDOW), reason=f"needs {', '.join(NO_WINDOW)}")
def test_widgets_work_in_a_window_and_survive_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    with screen() as display:
        monkeypatch.setenv("DISPLAY", display)
        monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
        scene = Scene(robots=[SerialRobot.from_model("lwr")], name="widgets")
        with sero_mj.view(scene, size=(400, 300)) as viewer:
            threads: list[threading.Thread] = []
            panel = viewer.panel("Tuning")
            reset = panel.button(
                "reset", on_click=lambda: threads.append(threading.current_thread())
            )
            gain = panel.slider("gain", 0, 1, value=0.5)
            places = iter(range(40, 300, 8))

            def is_pressed() -> bool:
                at = ["xdotool", "mousemove", "30", str(next(places)), "click", "1"]
                subprocess.run(at, check=True, timeout=20)
                shown = viewer.frame_count
                assert until(lambda: viewer.frame_count > shown + 2, 60)
                return until(lambda: reset.value > 0, 0.2)

            assert until(lambda: viewer.frame_count > 3, 60)
            assert until(is_pressed, 120)
            assert threads == []
            assert viewer.sync()
            assert threads == [threading.main_thread()] * reset.value

            process = viewer._process._process
            process.send_signal(signal.SIGSTOP)  # as if it hung
            note = panel.text("")
            begin = time.monotonic()
            for k in range(1000):
                note.value = f"{k}" * 10_000  # more than a pipe buffers
                assert viewer.sync()
            assert time.monotonic() - begin < 1.0
            process.send_signal(signal.SIGCONT)
            os.kill(process.pid, signal.SIGKILL)
            assert until(lambda: not viewer.sync(), 60)
            gain.value = 0.7
            assert gain.value == 0.7
            with pytest.raises(SeroError, match="cannot add a widget: the viewer is closed"):
                panel.button("more")
