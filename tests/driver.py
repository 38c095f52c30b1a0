"""A window or page in a separate process, queried line by line."""

from __future__ import annotations

import json
import os
import queue
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, Self

from commands import start_program

# Code before every program. `answer()` evaluates the received expressions and prints the results.
_PRELUDE = """
import json, queue, sys, threading
import numpy as np
lines = queue.SimpleQueue()
def read():
    for line in sys.stdin:
        lines.put(line)
threading.Thread(target=read, daemon=True).start()
def answer():
    while not lines.empty():
        found = eval(lines.get(), globals())
        if hasattr(found, "tolist"):
            found = found.tolist()
        print("=" + json.dumps(found), flush=True)
"""


class Driver:
    """A process that evaluates Python expressions: one line each, answered by `=` and JSON.

    The process first prints `ready`.

    Args:
        program: Python code, which must call `answer()` regularly.
        arguments: first argument of the program, as JSON.
        folder: working directory.
        environment: environment variables of the process.
        errors: file for standard error; None for the standard error of the tests.
    """

    goodbye = ""  # an expression that closes the window or page
    patience = 15  # timeout of `until`, s
    opens_windows = False

    def __init__(
        self,
        program: str,
        arguments: Any,
        folder: Path,
        environment: Mapping[str, str] = os.environ,
        errors: IO[str] | None = None,
    ) -> None:
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        its_input, to_it = os.pipe()
        from_it, its_output = os.pipe()
        streams = {0: its_input, 1: its_output}
        if errors is not None:
            streams[2] = errors.fileno()
        set_arguments = f"import sys\nsys.argv[1:] = [{json.dumps(arguments)!r}]\n"
        self.process = start_program(
            set_arguments + _PRELUDE + program,
            folder,
            environment,
            streams,
            opens_windows=self.opens_windows,
        )
        os.close(its_input)
        os.close(its_output)
        self._input, self._output = os.fdopen(to_it, "w"), os.fdopen(from_it)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self._expect("ready", 60)

    def _read(self) -> None:
        for line in self._output:
            self._lines.put(line.strip())
        self._lines.put("")  # no further output

    def _expect(self, start: str, seconds: float) -> str:
        end = time.monotonic() + seconds
        while True:
            try:
                line = self._lines.get(timeout=max(end - time.monotonic(), 0.01))
            except queue.Empty:
                raise AssertionError(f"no '{start}' within {seconds} s") from None
            assert line, f"the process ended before it printed '{start}'"
            if line.startswith(start):
                return line

    def ask(self, expression: str) -> Any:
        """Returns the current value of an expression about the window `w`."""
        self._input.write(expression + "\n")
        self._input.flush()
        return json.loads(self._expect("=", 20)[1:])

    def until(self, expression: str) -> Any:
        """Waits until an expression is true, and returns its value."""
        end = time.monotonic() + self.patience
        while True:
            found = self.ask(expression)
            if found:
                return found
            assert time.monotonic() < end, f"never true: {expression}"

    def close(self) -> None:
        """Ends the process like a user who closes the window."""
        process = self.process
        try:
            if process.is_alive():
                self._input.write(f"{self.goodbye}\n")
                self._input.flush()
                process.join(20)
                assert not process.is_alive(), "the process did not end"
        finally:
            process.kill()
            process.join()
            self._reader.join()
            self._input.close()
            self._output.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
