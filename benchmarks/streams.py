"""Measures receivers of packets: rates without loss, and latencies to `MjData` and to pixels.

    .venv/bin/python benchmarks/streams.py [--quick]

Requires a C compiler, because the sender and the reference receiver are in C. Packets have 112
bytes and use the loopback interface. Other load on the machine reduces the rates.
"""

from __future__ import annotations

import argparse
import os
import socket
import subprocess
import tempfile
import threading
import time
import timeit
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from sero_mj.viewer.image.backend import choose_backend

choose_backend()

import numpy as np
from mcap.writer import Writer
from rich.console import Console
from rich.table import Table

from sero_mj import HeadlessRenderer, Mirror, Scene, SerialRobot, ShmReader, UdpReceiver
from sero_mj.data.receive.source import Source
from sero_mj.data.receive.structure import Structure
from sero_mj.data.record.recorder import SIGNALS_RATE
from sero_mj.data.record.recording import Recording
from sero_mj.data.record.recording_writer import FLUSH_AFTER, RecordingWriter
from sero_mj.extensions.fri.receiver import FriLayout, FriReceiver, no_command
from sero_mj.load import load_scene

Row = tuple[str, str, str, str, str]
HERE = Path(__file__).parent
STRUCTURE = "count:1F sent:1F joints:7F 5F"
SHM_STRUCTURE = "lock:1Q sent:1F joints:7F 5F"
PACKET_BYTES = 112
RATES = (20_000, 50_000, 100_000, 150_000, 200_000, 300_000, 400_000)  # packets per second
FPS = 30
# An open receiver: its port, and a function that waits for the end and returns the packet count.
Receiving = tuple[int, Callable[[], int]]


def compile_c(folder: Path) -> dict[str, str]:
    """Compiles the C programs in this folder; returns the executables by name."""
    programs = {}
    for source in HERE.glob("*.c"):
        programs[source.stem] = str(folder / source.stem)
        compiler = os.environ.get("CC", "cc")
        subprocess.run(
            [compiler, "-O2", "-o", programs[source.stem], str(source), "-lrt"], check=True
        )
    return programs


def mirror_of(source: Source) -> Mirror:
    robot = SerialRobot.from_model("lwr", show_arrows=True)
    routes = {"lwr.joint_angles": "stream.joints"}
    return Mirror(Scene(robots=[robot], sources={"stream": source}, routes=routes))


@contextmanager
def render_loop(mirror: Mirror) -> Iterator[list[int]]:
    """Renders 30 frames per second in a thread like a viewer; yields a list with their count."""
    stop, frames = threading.Event(), [0]

    def run() -> None:
        with HeadlessRenderer(mirror.world, 640, 480) as renderer:
            pixels = np.empty((480, 640, 3), np.uint8)
            due = time.monotonic()
            while not stop.wait(max(due - time.monotonic(), 0.0)):
                due = max(due + 1 / FPS, time.monotonic())
                mirror.advance()
                renderer.render(mirror.data, out=pixels)
                frames[0] += 1

    thread = threading.Thread(target=run)
    thread.start()
    while not frames[0]:  # the creation of the OpenGL context takes time
        time.sleep(0.01)
    yield frames
    stop.set()
    thread.join()


def settle(count: Callable[[], int]) -> int:
    """Waits until no more packets arrive; returns the number of packets."""
    before = -1
    while (now := count()) != before:
        before = now
        time.sleep(0.2)
    return now


@contextmanager
def our_receiver(only_latest: bool) -> Iterator[Receiving]:
    """Receives packets with a mirror that is rendered.

    Counts received packets, or applied packets in the lossless mode.
    """
    source = UdpReceiver(structure=STRUCTURE, only_latest_packet=only_latest)
    applied = [0]

    def add(_: str, packets: object) -> None:
        applied[0] += len(packets)  # type: ignore[arg-type]

    with mirror_of(source) as mirror, render_loop(mirror):
        mirror.listen(add)
        came = (lambda: source.counters.received) if only_latest else (lambda: applied[0])
        yield source.port, lambda: settle(came)


@contextmanager
def bare_python() -> Iterator[Receiving]:
    """Receives one packet at a time with `recv_into` in a minimal Python loop."""
    count, stop = [0], threading.Event()
    with socket.socket(type=socket.SOCK_DGRAM) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(0.2)

        def run() -> None:
            buffer = bytearray(PACKET_BYTES)
            while not stop.is_set():
                try:
                    sock.recv_into(buffer)
                except TimeoutError:
                    continue
                count[0] += 1

        thread = threading.Thread(target=run)
        thread.start()
        yield sock.getsockname()[1], lambda: settle(lambda: count[0])
        stop.set()
        thread.join()


@contextmanager
def bare_c(program: str) -> Iterator[Receiving]:
    """Receives packets with a `recvmmsg` loop in C, which gives the maximum possible rate."""
    with subprocess.Popen([program, "1"], stdout=subprocess.PIPE, text=True) as sink:
        assert sink.stdout is not None
        yield int(sink.stdout.readline()), lambda: int(sink.stdout.readline())  # type: ignore


def flood(program: str, port: int, rate: int, count: int) -> float:
    """Sends `count` packets at a rate; returns the actual rate."""
    command = [program, str(port), str(rate), str(count)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return float(done.stdout.split()[1])


def throughput(programs: dict[str, str], seconds: float) -> list[Row]:
    """Returns the highest of `RATES` without loss for each receiver."""
    contenders: dict[str, Callable[[], object]] = {
        "recvmmsg loop in C, alone": lambda: bare_c(programs["udp_sink"]),
        "recv_into loop in Python, alone": bare_python,
        "UdpReceiver, latest wins, rendering": lambda: our_receiver(True),
        "UdpReceiver, none lost, rendering": lambda: our_receiver(False),
    }
    rows: list[Row] = []
    reference = 0.0
    for name, make in contenders.items():
        best, first_loss = 0.0, ""
        for rate in RATES:
            count = int(rate * seconds)
            with make() as (port, finish):  # type: ignore[attr-defined]
                reached = flood(programs["udp_flood"], port, rate, count)
                came = finish()
            if came < count:
                first_loss = f"{1 - came / count:.1%} lost at {reached:,.0f}/s"
                break
            best = max(best, reached)
        reference = reference or best
        goal = "100,000/s" if "rendering" in name else ""
        rows.append((name, f"{best:,.0f}/s", first_loss, f"{best / reference:.2f}", goal))
    return rows


def latency(programs: dict[str, str], seconds: float) -> list[Row]:
    """Returns latencies from sending to `MjData` at 1 kHz, and to pixels at 30 frames/s."""
    udp = UdpReceiver(structure=STRUCTURE)
    block = f"/sero_bench_{os.getpid()}"
    shm = ShmReader(block=block, structure=SHM_STRUCTURE, lock="lock")
    rows: list[Row] = []
    for kind, source in (("UDP", udp), ("shared memory", shm)):
        applied: list[float] = [0.0]  # send times of applied packets
        with mirror_of(source) as mirror:
            mirror.listen(lambda _, packets: applied.append(packets.values["sent"][-1, 0]))
            program, to = ("udp_flood", udp.port) if source is udp else ("shm_beat", block)
            command = [programs[program], str(to), "1000", str(int(1000 * seconds))]
            to_data = _to_data(mirror, applied, command)
            to_pixels = _to_pixels(mirror, applied, command)
        for what, times, goal in (
            ("to MjData, 1 kHz", to_data, "p99 under 1 ms"),
            ("to pixels, 640x480, 30 fps", to_pixels, ""),
        ):
            p50, p99 = np.percentile(times, [50, 99]) * 1e3
            rows.append((f"{kind} {what}", f"p50 {p50:.3f} ms", f"p99 {p99:.3f} ms", "", goal))
    return rows


def _to_data(mirror: Mirror, applied: list[float], command: list[str]) -> list[float]:
    ages = []
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as sender:
        while mirror.wait_next(0.5) or sender.poll() is None:
            if mirror.advance():
                ages.append(time.monotonic() - applied[-1])
    return ages


def _to_pixels(mirror: Mirror, applied: list[float], command: list[str]) -> list[float]:
    ages = []
    with HeadlessRenderer(mirror.world, 640, 480) as renderer:
        pixels = np.empty((480, 640, 3), np.uint8)
        renderer.render(mirror.data, out=pixels)
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as sender:
            due = time.monotonic()
            while sender.poll() is None:
                time.sleep(max(due - time.monotonic(), 0.0))
                due += 1 / FPS
                if mirror.advance():
                    renderer.render(mirror.data, out=pixels)
                    ages.append(time.monotonic() - applied[-1])
    return ages


def answers(programs: dict[str, str], seconds: float) -> list[Row]:
    """Returns the share and delay of answers to FRI packets at 1 kHz, and the time of checks."""
    goal = "99.9 % answered, 99 % within 2 ms"
    scene = load_scene("lwr_fri")
    scene.sources["fri"] |= {"port": 0, "answer": True}
    rows: list[Row] = []
    with Mirror(scene) as mirror, render_loop(mirror):
        source = mirror.sources["fri"]
        assert isinstance(source, FriReceiver)
        rows.append(("FRI at 1 kHz, rendering", *_answered(programs, source.port, seconds), goal))
        with bare_answers() as port:
            row = "bare recvfrom and sendto, rendering", *_answered(programs, port, seconds), ""
        rows.append(row)
    packets = {
        "FRI": (FriReceiver(udpport=0), FriLayout().encode({})),
        "7F7F": (UdpReceiver(structure="7F7F"), bytes(PACKET_BYTES)),
    }
    for name, (receiver, packet) in packets.items():
        row, length = np.frombuffer(packet, np.uint8)[None], np.array([len(packet)])
        count = [0]

        def check(row=row, length=length, receiver=receiver, count=count) -> None:  # type: ignore
            count[0] += 1
            receiver._accept(row, length, np.array([1e-3 * count[0]]))

        one = min(timeit.repeat(check, number=1000, repeat=7)) / 1000
        limit = "at most 80 us" if name == "FRI" else ""
        rows.append((f"check {name}, one packet", f"{one * 1e6:.0f} us", "", "", limit))
    return rows


def _answered(programs: dict[str, str], port: int, seconds: float) -> tuple[str, str, str]:
    command = [programs["fri_master"], str(port), "1000", str(int(1000 * seconds))]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    _, answered, within, p50, p99, longest = done.stdout.split()
    return f"{answered} %, {within} % in 2 ms", f"p50 {p50}, p99 {p99}, max {longest} us", ""


@contextmanager
def bare_answers() -> Iterator[int]:
    """Answers FRI packets with a minimal loop in a thread; yields its port."""
    stop = threading.Event()
    with socket.socket(type=socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(0.2)

        def run() -> None:
            count = 0
            while not stop.is_set():
                try:
                    packet, sender = sock.recvfrom(2048)
                except TimeoutError:
                    continue
                count += 1
                sock.sendto(no_command(count, int.from_bytes(packet[:2], "little")), sender)

        thread = threading.Thread(target=run)
        thread.start()
        yield sock.getsockname()[1]
        stop.set()
        thread.join()


def recording(folder: Path) -> list[Row]:
    """Returns disk space and time for a recording of 19 doubles at 1 kHz.

    The reference is an MCAP file with only the same packets, in the chunks of its library. Chunks
    of a recorder are smaller, so that few data are lost in a crash, and a recorder also stores some
    decoded packets.
    """
    structure, count = Structure("19F"), 20_000
    size, times = 19 * 8, np.arange(count) / 1000
    smooth = np.sin(times[:, None] * np.arange(1, 20))
    noise = np.random.default_rng(0).normal(scale=0.01, size=smooth.shape)
    rows: list[Row] = []
    path, events = folder / "run.mcap", dict(structure.events)
    for name, values in (
        ("noise of 0.01", smooth + noise),
        ("smooth", smooth),
        ("steps of 1e-4", np.round(smooth / 1e-4) * 1e-4),
    ):
        packets = [structure.encode({"values0": row}) for row in values]
        bare = _bare_mcap(folder / "bare.mcap", packets)
        with RecordingWriter(path, about={}, overwrite=True) as writer:
            writer.add_source("udp", kind="udp", declared={}, events=events, size=size)
            begin, work = time.monotonic(), time.process_time()
            for k, packet in enumerate(packets):
                writer.write_raw("udp", packet, begin + k / 1000)
                if k % round(1000 / SIGNALS_RATE) == 0:
                    writer.write_signals("udp", structure.decode(packet), begin + k / 1000)
                if k % round(1000 * FLUSH_AFTER) == 0:
                    writer.flush()
            work = time.process_time() - work
        own = path.stat().st_size
        begin = time.perf_counter()
        with Recording(path) as found:
            assert sum(1 for _ in found.packets("udp")) == count
        read = time.perf_counter() - begin
        rows.append(
            (f"record 19 doubles at 1 kHz, {name}", f"{own / count * 3.6e-3:.2f} GB/h",
             f"{work / count * 1e6:.0f} us to write, {read / count * 1e6:.1f} us to read",
             f"{own / bare:.2f} of MCAP", "at most 1.1")
        )  # fmt: skip
    return rows


def _bare_mcap(path: Path, packets: Sequence[bytes]) -> int:
    """Returns the size in bytes of an MCAP file with only the packets."""
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/udp", "raw", writer.register_schema("", "", b""))
        for k, packet in enumerate(packets):
            writer.add_message(channel, k * 10**6, packet, k * 10**6, k)
        writer.finish()
    return path.stat().st_size


def decoding() -> list[Row]:
    """Returns the time to decode packets, relative to `numpy.frombuffer` for the same arrays."""
    structure = Structure("7F7F")
    packet = np.arange(14.0).tobytes()
    rows_of_bytes = np.frombuffer(packet * 256, np.uint8).reshape(256, PACKET_BYTES)

    def bare() -> None:
        np.frombuffer(packet, "<f8", 7)
        np.frombuffer(packet, "<f8", 7, 56)

    def best(work: Callable[[], object], number: int) -> float:
        return min(timeit.repeat(work, number=number, repeat=7)) / number

    one, ours = best(bare, 20_000), best(lambda: structure.decode(packet), 20_000)
    many = best(lambda: structure.decode_rows(rows_of_bytes), 2_000) / 256
    return [
        ("decode 7F7F, one packet", f"{ours * 1e9:.0f} ns", f"frombuffer {one * 1e9:.0f} ns",
         f"{ours / one:.2f}", "at most 2"),
        ("decode 7F7F, 256 at once", f"{many * 1e9:.0f} ns", f"frombuffer {one * 1e9:.0f} ns",
         f"{many / one:.2f}", "at most 2"),
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="1 s per measurement instead of 5 s")
    options = parser.parse_args()
    seconds = 1.0 if options.quick else 5.0
    console = Console(width=130)
    table = Table("measurement", "result", "reference", "ratio", "goal", title="sero-mj streams")
    with tempfile.TemporaryDirectory() as folder:
        programs = compile_c(Path(folder))
        for row in [
            *decoding(),
            *recording(Path(folder)),
            *answers(programs, seconds),
            *latency(programs, seconds),
            *throughput(programs, seconds),
        ]:
            table.add_row(*row)
    console.print(table)


if __name__ == "__main__":
    main()
