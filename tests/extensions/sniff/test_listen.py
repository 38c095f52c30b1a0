"""`structure --sniff`: packets of a multicast group."""

from __future__ import annotations

import socket
import struct

import pytest
from polling import until

from sero_mj.cli import main
from sero_mj.extensions.sniff.listen import Sniffer

GROUP = "239.255.73.1"


def test_multicast_group_is_received_on_an_interface(capsys: pytest.CaptureFixture[str]) -> None:
    with Sniffer(GROUP, 0, "127.0.0.1") as sniffer:
        with socket.socket(type=socket.SOCK_DGRAM) as sock:
            loopback = socket.inet_aton("127.0.0.1")
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
            sock.sendto(struct.pack("<d", 2.5), (GROUP, sniffer.port))
        assert until(lambda: (sniffer.receive(0.1, 1), sniffer.received == 1)[1])
    with pytest.raises(SystemExit) as caught:
        main(["structure", "--sniff", "32177", "--host", GROUP, "--interface", "eth77"])
    assert caught.value.code == 2
    assert "no network interface 'eth77'; available: " in capsys.readouterr().err
    with pytest.raises(SystemExit) as caught:
        main(["structure", "7F", "--interface", "lo"])
    assert "--interface needs --sniff PORT" in capsys.readouterr().err


def test_packets_are_printed_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["structure", "1F", "--sniff", "32178", "--duration", "0.05", "--json"])
    assert caught.value.code == 0
    assert '"packets": 0' in capsys.readouterr().out
