"""Shows a robot on a page for long, at 1000 packets a second; tells every second what it costs.

    .venv/bin/python benchmarks/soak.py SECONDS

Prints a line of JSON a second: time (s), resident memory (MiB), open handles, threads, from sending
a packet to its state in a message to the page (p50, p99, ms), packets received, states sent. A
client takes the states as a browser does. On the way the sender is silent for two seconds and then
sends all at once, and the process that shows is suspended for as long. Needs a C compiler, Linux.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from streams import STRUCTURE, compile_c, mirror_of
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from sero_mj import UdpReceiver
from sero_mj.viewer.web.host import WebHost
from sero_mj.viewer.web.server import socket_url

RATE = 1000  # packets/s
PAUSE = 2.0  # s, of the sender and of the process that shows
SILENT_AT, SUSPENDED_AT = 1 / 3, 2 / 3  # of the whole time


def resources() -> dict[str, Any]:
    """What this process has."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return {
        "memory": pages * os.sysconf("SC_PAGE_SIZE") / 2**20,
        "handles": len(os.listdir("/proc/self/fd")),
        "threads": threading.active_count(),
    }


def take_states(url: str) -> None:
    """Takes and answers messages until the page is closed."""
    with connect(socket_url(url, "/live"), max_size=None) as line:
        try:
            while True:
                if not isinstance(line.recv(), str):
                    line.send('{"t": "got"}')
        except ConnectionClosed:
            return


def serve() -> None:
    """Shows the robot until standard input ends."""
    source = UdpReceiver(structure=STRUCTURE)
    ages: list[float] = []
    applied = [0.0]
    over = threading.Event()

    def wait_for_end() -> None:
        sys.stdin.read()
        over.set()

    threading.Thread(target=wait_for_end, daemon=True).start()
    with mirror_of(source) as mirror, WebHost(mirror) as page:
        mirror.listen(lambda _, packets: applied.append(packets.values["sent"][-1, 0]))
        print(json.dumps({"port": source.port, "url": page.url}), flush=True)
        begin = told = time.monotonic()
        while page.frame() and not over.is_set():
            now = time.monotonic()
            if len(applied) > 1:
                ages.append(now - applied[-1])
                applied[1:] = []
            if now - told < 1.0:
                continue
            told = now
            p50, p99 = np.percentile(ages, [50, 99]) * 1e3 if ages else (None, None)
            ages.clear()
            found = {"time": now - begin, **resources(), "p50": p50, "p99": p99}
            found |= {"received": source.counters.received, "states": page.browsers.sent}
            print(json.dumps(found), flush=True)


def soak(seconds: float) -> Iterator[dict[str, Any]]:
    """Gives what the process that shows tells, every second."""
    with tempfile.TemporaryDirectory() as folder:
        program = compile_c(Path(folder))["udp_flood"]
        shows = subprocess.Popen(
            [sys.executable, __file__, "--serve"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert shows.stdout is not None and shows.stdin is not None
        at = json.loads(shows.stdout.readline())
        taker = threading.Thread(target=take_states, args=(at["url"],))
        taker.start()
        sends = [program, str(at["port"]), str(RATE), str(int(RATE * seconds))]
        with subprocess.Popen(sends, stdout=subprocess.DEVNULL) as sender:
            stops = [
                threading.Timer(share * seconds + later, process.send_signal, [what])
                for share, process in ((SILENT_AT, sender), (SUSPENDED_AT, shows))
                for later, what in ((0.0, signal.SIGSTOP), (PAUSE, signal.SIGCONT))
            ]
            for timer in stops:
                timer.start()
            while sender.poll() is None:
                yield json.loads(shows.stdout.readline())
        shows.stdin.close()
        for line in shows.stdout:
            yield json.loads(line)
        taker.join()
        if shows.wait():
            raise RuntimeError(f"the process that shows ended with {shows.returncode}")


if __name__ == "__main__":
    if sys.argv[1] == "--serve":
        serve()
    else:
        for told in soak(float(sys.argv[1])):
            print(json.dumps(told), flush=True)
