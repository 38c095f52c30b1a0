"""Shows a robot on a page for a long time at 1000 packets/s, and prints resources every second.

    .venv/bin/python benchmarks/soak.py SECONDS

Prints a line of JSON per second: time (s), resident memory (MiB), open handles, threads, latency
from sending a packet to sending the page a state with it (p50, p99, ms), received packets, and sent
states. A client receives the states like a browser. During the run, the sender pauses for two
seconds and then sends the delayed packets at once. Later, the process of the page is suspended for
two seconds. Requires Linux and a C compiler.
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

RATE = 1000  # packets per second
PAUSE = 2.0  # duration of the pauses of the sender and of the page's process, s
SILENT_AT, SUSPENDED_AT = 1 / 3, 2 / 3  # begins of the pauses as shares of the whole time


def resources() -> dict[str, Any]:
    """Returns the memory, handles and threads of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return {
        "memory": pages * os.sysconf("SC_PAGE_SIZE") / 2**20,
        "handles": len(os.listdir("/proc/self/fd")),
        "threads": threading.active_count(),
    }


def take_states(url: str) -> None:
    """Receives and confirms messages of a page until the page is closed."""
    with connect(socket_url(url, "/live"), max_size=None) as line:
        try:
            while True:
                if not isinstance(line.recv(), str):
                    line.send('{"t": "got"}')
        except ConnectionClosed:
            return


def serve() -> None:
    """Shows the robot on a page until standard input ends."""
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
        begin = printed = time.monotonic()
        while page.frame() and not over.is_set():
            now = time.monotonic()
            if len(applied) > 1:
                ages.append(now - applied[-1])
                applied[1:] = []
            if now - printed < 1.0:
                continue
            printed = now
            p50, p99 = np.percentile(ages, [50, 99]) * 1e3 if ages else (None, None)
            ages.clear()
            found = {"time": now - begin, **resources(), "p50": p50, "p99": p99}
            found |= {"received": source.counters.received, "states": page.browsers.sent}
            print(json.dumps(found), flush=True)


def soak(seconds: float) -> Iterator[dict[str, Any]]:
    """Yields the measurements that the process of the page prints every second."""
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
            raise RuntimeError(f"the process of the page ended with status {shows.returncode}")


if __name__ == "__main__":
    if sys.argv[1] == "--serve":
        serve()
    else:
        for found in soak(float(sys.argv[1])):
            print(json.dumps(found), flush=True)
