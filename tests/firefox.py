"""Controls pages in Firefox with WebDriver BiDi."""

from __future__ import annotations

import importlib.util
import itertools
import json
import os
import re
import shutil
import subprocess
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

from polling import until
from websockets.sync.client import connect
from window_tools import screen

FIREFOX = shutil.which("firefox-esr") or shutil.which("firefox")
MISSING = ["firefox"] * (FIREFOX is None) + ["Xvfb"] * (shutil.which("Xvfb") is None)
MISSING += ["websockets"] * (importlib.util.find_spec("websockets") is None)
PATIENCE = 60.0  # s
_SETTINGS = {
    "webgl.force-enabled": True,  # without a GPU
    "app.normandy.enabled": False,
    "browser.aboutwelcome.enabled": False,
    "datareporting.policy.dataSubmissionEnabled": False,
}


class Firefox:
    """A page in Firefox with a size in pixels.

    Attributes:
        faults: errors that the page has reported.
    """

    def __init__(self, size: tuple[int, int] = (900, 640)) -> None:
        assert FIREFOX is not None
        self._stack = ExitStack()
        enter = self._stack.enter_context
        folder = Path(enter(tempfile.TemporaryDirectory(ignore_cleanup_errors=True)))
        lines = [f"user_pref({json.dumps(k)}, {json.dumps(v)});" for k, v in _SETTINGS.items()]
        (folder / "user.js").write_text("\n".join(lines))
        display = enter(screen())
        said = enter((folder / "said.txt").open("w"))
        self._process = enter(
            subprocess.Popen(
                [FIREFOX, "--headless", "--no-remote", "--profile", str(folder),
                 "--remote-debugging-port=0", "about:blank"],
                stdout=subprocess.DEVNULL,
                stderr=said,
                env={**os.environ, "DISPLAY": display, "HOME": str(folder)},
            )
        )  # fmt: skip
        self._stack.callback(self._process.terminate)
        address = re.compile(r"BiDi listening on (ws://\S+)")
        assert until(lambda: address.search((folder / "said.txt").read_text()), PATIENCE)
        url = address.findall((folder / "said.txt").read_text())[0]
        self._line = enter(connect(f"{url}/session", max_size=None, proxy=None))
        self._numbers = itertools.count(1)
        self.faults: list[str] = []
        self._do("session.new", capabilities={})
        self._do("session.subscribe", events=["log.entryAdded"])
        (context,) = self._do("browsingContext.getTree")["contexts"]
        self._context = context["context"]
        viewport = {"width": size[0], "height": size[1]}
        self._do("browsingContext.setViewport", context=self._context, viewport=viewport)

    def _do(self, method: str, **params: Any) -> Any:
        number = next(self._numbers)
        self._line.send(json.dumps({"id": number, "method": method, "params": params}))
        while True:
            found = json.loads(self._line.recv(timeout=PATIENCE))
            if found.get("method") == "log.entryAdded" and found["params"]["level"] == "error":
                self.faults.append(found["params"]["text"])
            if found.get("id") == number:
                assert found["type"] == "success", found
                return found["result"]

    def goto(self, url: str) -> None:
        """Opens a page and waits until it is ready."""
        self._do("browsingContext.navigate", context=self._context, url=url, wait="complete")
        self.until("document.documentElement.dataset.ready === '1'")

    def evaluate(self, expression: str) -> Any:
        """Returns the value of a page expression."""
        found = self._do(
            "script.evaluate",
            expression=f"JSON.stringify({expression})",
            target={"context": self._context},
            awaitPromise=True,
        )
        assert found["type"] == "success", found["exceptionDetails"]["text"]
        return json.loads(found["result"].get("value", "null"))

    def until(self, expression: str) -> None:
        """Waits until an expression is true."""
        is_true = until(lambda: self.evaluate(f"Boolean({expression})"), PATIENCE)
        assert is_true, (expression, self.faults)

    def click(self, selector: str) -> None:
        """Clicks on the first element that a selector finds."""
        x, y = self.evaluate(
            "(({ left, top, width, height }) => [left + width / 2, top + height / 2])"
            f"(document.querySelector({json.dumps(selector)}).getBoundingClientRect())"
        )
        self.click_at(x, y)

    def click_at(self, x: float, y: float) -> None:
        """Clicks at a pixel of the page."""
        acts = [
            {"type": "pointerMove", "x": round(x), "y": round(y)},
            {"type": "pointerDown", "button": 0},
            {"type": "pointerUp", "button": 0},
        ]
        pointer = {"type": "pointer", "id": "mouse", "actions": acts}
        self._do("input.performActions", context=self._context, actions=[pointer])

    def press(self, key: str) -> None:
        """Presses a key."""
        acts = [{"type": kind, "value": key} for kind in ("keyDown", "keyUp")]
        keys = {"type": "key", "id": "keys", "actions": acts}
        self._do("input.performActions", context=self._context, actions=[keys])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._stack.close()
