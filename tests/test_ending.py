"""Commands that are terminated report what they have received."""

from __future__ import annotations

import signal
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest

SCENE = """
[robots.arm]
dh_convention = "craig"
dh_params = [[0, 0, 0, 0.2], [0, 0.3, 0, 0]]

[sources.udp]
kind = "udp"
port = {port}
structure = "2F"

[routes]
"arm.joint_angles" = "udp.values0"
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="there are no such signals")
@pytest.mark.parametrize("command", ["status", "record"])
@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGINT])
def test_terminated_command_reports_what_it_received(
    command: str, sent: signal.Signals, tmp_path: Path
) -> None:
    file = tmp_path / "scene.toml"
    with socket.socket(type=socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        port = sock.getsockname()[1]
    file.write_text(SCENE.format(port=port))
    arguments = [command, str(file), *([str(tmp_path / "out.mcap")] * (command == "record"))]
    with (
        socket.socket(type=socket.SOCK_DGRAM) as sock,
        subprocess.Popen(
            [sys.executable, "-m", "sero_mj", *arguments], stdout=subprocess.PIPE, text=True
        ) as process,
    ):
        sock.connect(("127.0.0.1", port))
        heard = 0
        end = time.monotonic() + 20.0
        while heard < 10 and time.monotonic() < end:
            time.sleep(0.05)
            try:  # rejected until it listens
                heard += sock.send(struct.pack("<2d", 0.0, 0.0)) > 0
            except ConnectionRefusedError:
                heard = 0
        process.send_signal(sent)
        out = process.communicate(timeout=10.0)[0]
    assert process.returncode == 0
    assert "packets in" in out if command == "record" else "received" in out
