"""`UdpReceiver` on networks: multicast groups, IPv6, declared senders, and no recvmmsg."""

from __future__ import annotations

import socket
import struct
import sys
from collections.abc import Iterator
from contextlib import ExitStack

import pytest
from conftest import raises_with
from polling import until

from sero_mj.base.errors import DeclarationError, SourceError
from sero_mj.data.receive import udp_socket
from sero_mj.data.receive.udp import UdpReceiver
from sero_mj.data.receive.udp_socket import Datagrams, pack_address, unpack_address

GROUP, GROUP6 = "239.255.73.1", "ff02::7357"


def packet(value: float) -> bytes:
    return struct.pack("<d", value)


def values_of(receiver: UdpReceiver) -> list[float]:
    return receiver.latest().values["values0"].tolist()


@pytest.fixture
def two() -> Iterator[tuple[socket.socket, socket.socket]]:
    """Two senders on loopback."""
    with ExitStack() as stack:
        socks = [stack.enter_context(socket.socket(type=socket.SOCK_DGRAM)) for _ in range(2)]
        for sock in socks:
            sock.bind(("127.0.0.1", 0))
        yield socks[0], socks[1]


def test_only_packets_of_the_declared_sender_are_accepted(
    two: tuple[socket.socket, socket.socket],
) -> None:
    friend, stranger = two
    name = f"127.0.0.1:{friend.getsockname()[1]}"
    with UdpReceiver(structure="1F", sender=name) as receiver:
        there = ("127.0.0.1", receiver.port)
        for k in range(5):
            stranger.sendto(packet(-k), there)
            friend.sendto(packet(k), there)
        stranger.sendto(b"nonsense", there)
        assert until(lambda: receiver.counters.received == 11)
        counters = receiver.counters
        assert (counters.foreign, counters.malformed, counters.senders) == (6, 0, 1)
        assert values_of(receiver) == [4.0]
        assert receiver.receive_trigger == 5


def test_senders_are_declared_without_ports_and_in_lists(
    two: tuple[socket.socket, socket.socket],
) -> None:
    for sender, foreign in ((["127.0.0.1"], 0), (["192.0.2.1"], 2), (["::1", "192.0.2.1"], 2)):
        with UdpReceiver(structure="1F", sender=sender) as receiver:
            for sock in two:
                sock.sendto(packet(1.0), ("127.0.0.1", receiver.port))
            assert until(lambda receiver=receiver: receiver.counters.received == 2)
            assert receiver.counters.foreign == foreign


def test_ten_concurrent_senders_are_tracked_separately() -> None:
    receiver = UdpReceiver(structure="n:1H 1F", sequence="n", only_latest_packet=False)
    with ExitStack() as stack:
        stack.enter_context(receiver)
        socks = [stack.enter_context(socket.socket(type=socket.SOCK_DGRAM)) for _ in range(10)]
        for k in range(50):
            for i, sock in enumerate(socks):
                if (k, i) != (20, 3):  # one lost packet
                    sock.sendto(struct.pack("<Hd", 1000 * i + k, i), ("127.0.0.1", receiver.port))
        assert until(lambda: receiver.counters.received == 499)
        counters = receiver.counters
        assert (counters.senders, counters.lost) == (10, 1)
        assert (counters.late, counters.duplicates, counters.restarts) == (0, 0, 0)
        assert len(receiver.take() or ()) == 499


@pytest.mark.parametrize("sender", ["192.168.0", "somebody", "127.0.0.1:x", "127.0.0.1:70000", ""])
def test_sender_that_is_not_an_address_is_rejected(sender: str) -> None:
    UdpReceiver(structure="1F", sender="[::1]:7")
    with pytest.raises(DeclarationError) as caught:
        UdpReceiver(structure="1F", sender=sender)
    assert str(caught.value) == (
        f"sender: found {sender!r}; expected an address such as 192.168.0.7, 192.168.0.7:1234 or "
        "[fe80::1]:1234"
    )


def test_two_receivers_can_join_a_multicast_group() -> None:
    with ExitStack() as stack:
        first = stack.enter_context(UdpReceiver(structure="1F", host=GROUP, interface="127.0.0.1"))
        second = UdpReceiver(structure="1F", host=GROUP, interface="127.0.0.1", udpport=first.port)
        stack.enter_context(second)
        sock = stack.enter_context(socket.socket(type=socket.SOCK_DGRAM))
        loopback = socket.inet_aton("127.0.0.1")
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
        sock.sendto(packet(2.5), (GROUP, first.port))
        for receiver in (first, second):
            assert receiver.wait(5.0)
            assert values_of(receiver) == [2.5]


@pytest.mark.skipif(sys.platform != "linux", reason="the loopback interface is called lo")
def test_multicast_group_is_joined_on_a_named_interface() -> None:
    with ExitStack() as stack:
        sock = stack.enter_context(socket.socket(socket.AF_INET6, socket.SOCK_DGRAM))
        index = socket.if_nametoindex("lo")
        sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_IF, index)
        receiver = UdpReceiver(structure="1F", host=GROUP6, interface="lo")
        try:
            stack.enter_context(receiver)
            sock.sendto(packet(3.5), (GROUP6, receiver.port))
        except OSError as error:
            pytest.skip(f"no IPv6 groups on loopback here: {error}")
        assert receiver.wait(5.0)
        assert values_of(receiver) == [3.5]
    with UdpReceiver(structure="1F", host=GROUP, interface="lo") as receiver:
        assert receiver.port


def test_unknown_interface_is_reported_with_available_ones() -> None:
    receiver = UdpReceiver(structure="1F", host=GROUP, interface="eth77", udpport=32_123)
    with pytest.raises(SourceError) as caught:
        receiver.open()
    text = str(caught.value)
    assert f"UDP port 32123 on {GROUP}: no network interface 'eth77'; available: " in text
    assert all(name in text for _, name in socket.if_nameindex())


@pytest.mark.parametrize("host", ["127.0.0.1", "192.168.77.200", "::1", "fe80::1234:5"])
def test_packed_addresses_round_trip(host: str) -> None:
    packed = pack_address(host, 54_321)
    assert len(packed) == 28
    assert unpack_address(packed) == (host, 54_321)


@pytest.mark.parametrize("at_once", [True, False])
def test_recvmmsg_and_fallback_read_the_same_packets(
    two: tuple[socket.socket, socket.socket], monkeypatch: pytest.MonkeyPatch, at_once: bool
) -> None:
    sent = [b"", b"ab", bytes(range(10)), bytes(65_507), b"z"]
    with socket.socket(type=socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        reader = Datagrams(sock, 8)
        if not at_once:
            monkeypatch.setattr(reader, "_recvmmsg", None)
        elif reader._recvmmsg is None:
            pytest.skip("no recvmmsg here")
        assert reader.receive() is None
        for data in sent:
            two[0].sendto(data, sock.getsockname())
        batch = reader.receive()
        assert batch is not None
        assert len(batch) == len(sent)
        for i, data in enumerate(sent):
            kept = min(len(data), 8)
            assert batch.rows[i, :kept].tobytes() == data[:kept]
            length = int(batch.lengths[i])
            assert length == len(data) if at_once or len(data) <= 8 else length > 8
            assert unpack_address(batch.senders[i].tobytes()) == two[0].getsockname()
        assert (batch.arrivals[1:] >= batch.arrivals[:-1]).all()


def test_more_packets_than_a_batch_are_read_in_several_batches() -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2**21)
        sock.bind(("127.0.0.1", 0))
        reader = Datagrams(sock, 8)
        with socket.socket(type=socket.SOCK_DGRAM) as sender:
            for k in range(udp_socket.BATCH + 3):
                sender.sendto(packet(k), sock.getsockname())
        lengths = []
        while (batch := reader.receive()) is not None:
            lengths.append(len(batch))
        assert sum(lengths) == udp_socket.BATCH + 3
        assert max(lengths) <= udp_socket.BATCH


@pytest.fixture
def six() -> Iterator[socket.socket]:
    """A sender on the IPv6 loopback."""
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as sock:
        try:
            sock.bind(("::1", 0))
        except OSError as error:
            pytest.skip(f"no IPv6 here: {error}")
        yield sock


@pytest.mark.parametrize(
    ("sender", "foreign"),
    [
        (["127.0.0.1", "::1"], []),
        (["127.0.0.1"], ["::1"]),
        (["::1"], ["127.0.0.1"]),
        (["::ffff:127.0.0.1"], ["::1"]),
        (["192.0.2.1"], ["127.0.0.1", "::1"]),
        ([], []),
    ],
)
def test_dual_stack_socket_accepts_declared_ipv4_and_ipv6_senders(
    two: tuple[socket.socket, socket.socket],
    six: socket.socket,
    sender: list[str],
    foreign: list[str],
) -> None:
    with UdpReceiver(structure="1F", host="::", sender=sender) as receiver:
        for _ in range(3):
            two[0].sendto(packet(4.0), ("127.0.0.1", receiver.port))
            six.sendto(packet(6.0), ("::1", receiver.port))
        assert until(lambda: receiver.counters.received == 6)
        assert receiver.counters.foreign == 3 * len(foreign)
        assert receiver.receive_trigger == 6 - 3 * len(foreign)


def test_dual_stack_socket_accepts_a_sender_with_port(
    two: tuple[socket.socket, socket.socket], six: socket.socket
) -> None:
    sender = f"127.0.0.1:{two[0].getsockname()[1]}"
    with UdpReceiver(structure="1F", host="::", sender=sender) as receiver:
        for sock in two:
            sock.sendto(packet(4.0), ("127.0.0.1", receiver.port))
        assert until(lambda: receiver.counters.received == 2)
        assert receiver.counters.foreign == 1


@pytest.mark.parametrize("sender", ["0.0.0.0", "0.0.0.0:4711", "::", "239.0.0.1", "[ff02::1]:5"])
def test_unspecified_and_multicast_senders_are_rejected(sender: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        UdpReceiver(structure="1F", sender=sender)
    expected = (
        f"found {sender!r}, which cannot be the address of a sender. Remove it to accept any sender"
    )
    assert str(caught.value) == f"sender: {expected}"


@pytest.mark.parametrize("host", ["ff02::1", "ff01::1", "fe80::1"])
def test_link_local_address_requires_an_interface(host: str) -> None:
    with pytest.raises(SourceError) as caught:
        UdpReceiver(structure="1F", host=host, udpport=32_124).open()
    names = ", ".join(name for _, name in socket.if_nameindex())
    assert str(caught.value) == (
        f"source 'udp': UDP port 32124 on {host}: this address exists on every network. Set "
        f"interface = ... to choose one; available: {names}"
    )


@pytest.mark.skipif(sys.platform != "linux", reason="the loopback interface is called lo")
def test_link_local_address_of_another_machine_is_reported() -> None:
    for fields in ({"host": "fe80::1234", "interface": "lo"}, {"host": "fe80::1234%lo"}):
        wrong = f"UDP port 0 on {fields['host']}: not an address of this machine"
        reason = f"{wrong}; expected 127.0.0.1 or 0.0.0.0, for example"
        with raises_with(SourceError, source="udp", reason=reason):
            UdpReceiver(structure="1F", **fields).open()  # type: ignore[arg-type]
    with pytest.raises(SourceError, match="no network interface 'eth77'; available: "):
        UdpReceiver(structure="1F", host="fe80::1234", interface="eth77").open()


@pytest.mark.parametrize("at_once", [True, False])
@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "::"])
def test_answer_reaches_the_sender(
    monkeypatch: pytest.MonkeyPatch, host: str, at_once: bool
) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as sock:
        try:
            sock.bind((host, 0))
        except OSError as error:
            pytest.skip(f"no IPv6 here: {error}")
        reader = Datagrams(sock, 8)
        if not at_once:
            monkeypatch.setattr(reader, "_recvmmsg", None)
            monkeypatch.setattr(reader, "_sendto", None)
        seen: list[tuple[bytes, int]] = []

        def answer(data: memoryview, length: int, sender: bytes) -> None:
            seen.append((bytes(data[:length]), length))
            reader.send(b"answer to " + data[:length], sender)

        reader.on_arrival = answer
        to = "127.0.0.1" if host == "::" else host  # a dual-stack socket receives IPv4
        with socket.socket(socket.AF_INET6 if ":" in to else socket.AF_INET, sock.type) as other:
            other.settimeout(5.0)
            for data in (b"one", b"two"):
                other.sendto(data, (to, sock.getsockname()[1]))
            assert until(lambda: (reader.receive(), len(seen) == 2)[1])
            assert [other.recv(99) for _ in range(2)] == [b"answer to one", b"answer to two"]
        assert seen == [(b"one", 3), (b"two", 3)]
        with pytest.raises(OSError, match="Invalid argument"):
            reader.send(b"x", pack_address("127.0.0.1" if ":" not in host else "::1", 0))
