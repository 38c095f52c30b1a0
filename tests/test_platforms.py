"""The data path needs nothing that only POSIX systems or Linux have.

A child process has these names taken away before sero-mj is imported, and believes that it runs on
Windows or macOS: packets come by UDP, move the robot, are recorded and replayed.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

# Names that Python has on Linux but not on Windows; for macOS, only the Linux-only ones.
WITHOUT = """
import ctypes, importlib, json, os, pathlib, signal, sys
platform = sys.argv[1]
if platform == "win32":  # where Python makes socket pairs of two TCP sockets
    import _socket
    del _socket.socketpair, _socket.AF_UNIX
import socket, urllib.request
import mujoco, numpy, pydantic, mcap.writer, zstandard, rich, platformdirs, subprocess, asyncio
import multiprocessing, tempfile, ssl, concurrent.futures, uuid, zoneinfo, lxml.etree
for name in dir(os):
    if name.startswith("sched_"):
        delattr(os, name)
if platform == "win32":
    for name in (
        "killpg", "setsid", "getpgid", "setpgid", "getuid", "geteuid", "fork", "forkpty", "fchmod",
        "mkfifo", "pread", "pwrite", "posix_fallocate", "fdatasync", "statvfs", "register_at_fork",
        "O_NONBLOCK", "O_CLOEXEC", "WNOHANG", "getloadavg", "nice", "sendfile", "memfd_create",
    ):
        if hasattr(os, name):
            delattr(os, name)
    for name in ("SIGKILL", "SIGHUP", "SIGQUIT", "SIGSTOP", "SIGCONT", "SIGUSR1", "SIGCHLD"):
        delattr(signal, name)
    for name in ("MSG_DONTWAIT", "SCM_RIGHTS", "CMSG_LEN", "CMSG_SPACE"):
        delattr(socket, name)

    class Socket(socket.socket):
        def __getattribute__(self, name):
            if name in ("recvmsg", "recvmsg_into", "sendmsg", "sendmsg_afalg"):
                raise AttributeError(f"'socket' object has no attribute '{name}'")
            return super().__getattribute__(name)

    socket.socket = Socket

    class Missing:
        def find_spec(self, name, path=None, target=None):
            if name in ("fcntl", "_posixshmem", "resource", "termios", "pwd", "grp", "pty", "tty"):
                raise ModuleNotFoundError(f"No module named '{name}'", name=name)

    for name in ("fcntl", "_posixshmem", "resource", "termios", "pwd", "grp", "pty", "tty"):
        sys.modules.pop(name, None)
    sys.meta_path.insert(0, Missing())


def no_library(name=None, *args, **kwargs):  # `None` is this process on POSIX systems
    raise TypeError("bad argument type for built-in operation")


ctypes.PyDLL = ctypes.CDLL = no_library
sys.platform = platform
"""
DATA_PATH = """
import math, pathlib
from sero_mj import Mirror, Replay, Scene, SerialRobot, ShmReader, UdpReceiver, record_sources
from sero_mj.base.errors import SourceError

folder = pathlib.Path(sys.argv[2])
routes = {"lwr.joint_angles": "udp.angles", "lwr.torques": "udp.torques"}
structure = "count:1I angles:7F torques:7F"


def scene_of(source):
    return Scene(robots=[SerialRobot.from_model("lwr")], sources={"udp": source}, routes=routes)


def told(mirror):
    torques = mirror.data.userdata[mirror.world.slots["lwr.torques"]]
    return {"angles": mirror.data.qpos.tolist(), "torques": torques.tolist()}


def wait_for(condition):
    import time

    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end, (source.counters, source.error, source.trouble)
        mirror.wait_next(0.1)
        mirror.advance()


source = UdpReceiver(name="udp", udpport=0, structure=structure, sequence="count")
out = socket.socket(type=socket.SOCK_DGRAM)
found = {}
with Mirror(scene_of(source)) as mirror, record_sources(mirror.sources, folder / "run.mcap"):
    for k in range(300):  # more than a batch
        values = {"count": k, "angles": [0.01 * k] * 7, "torques": [float(k)] * 7}
        out.sendto(source.layout.encode(values), ("127.0.0.1", source.port))
    wait_for(lambda: source.counters.received == 300)
    out.sendto(b"short", ("127.0.0.1", source.port))
    out.sendto(bytes(5000), ("127.0.0.1", source.port))
    wait_for(lambda: source.counters.wrong_size == 2)
    mirror.advance()
    found["live"] = told(mirror)
    counters = source.counters
    found["counters"] = [counters.received, counters.lost, counters.malformed, counters.failures]
    found["senders"] = counters.senders
replay = Replay(name="udp", file=folder / "run.mcap")
with Mirror(scene_of(replay)) as mirror:
    mirror.advance(replay.duration + 1.0)
    found["replayed"] = told(mirror)
    counters = mirror.sources["udp"].counters
    found["recorded"] = [counters.received, counters.malformed]
try:
    ShmReader(block="robot", structure="7F").open()
    found["shm"] = ""
except SourceError as error:
    found["shm"] = error.reason
print(json.dumps(found))
"""
EXPECTED: Any = {"angles": [2.99] * 7, "torques": [299.0] * 7}


@pytest.mark.slow
@pytest.mark.parametrize("platform", ["win32", pytest.param("darwin", marks=pytest.mark.thorough)])
def test_packets_move_a_robot_and_are_recorded_and_replayed(platform: str, tmp_path: Path) -> None:
    command = [sys.executable, "-c", WITHOUT + DATA_PATH, platform, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    assert "Traceback" not in done.stderr, done.stderr[-3000:]
    found = json.loads(done.stdout)
    for which in ("live", "replayed"):
        for key, values in EXPECTED.items():
            np.testing.assert_allclose(found[which][key], values)
    assert found["counters"] == [302, 0, 2, 0]
    assert found["recorded"] == [302, 2]
    assert found["senders"] == 1
    if platform == "win32":
        assert "no POSIX shared memory" in found["shm"]
