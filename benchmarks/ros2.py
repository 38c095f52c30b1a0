"""Measures the loss and latency of ROS 2 topics at 1 kHz, and the speed of replayed bags.

    .venv/bin/python benchmarks/ros2.py [--seconds 5]

A publisher in another process on this machine sends the states of 7 joints by Cyclone DDS. The
reference is a plain reader of Cyclone DDS that decodes each message.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

from sero_mj.viewer.image.backend import choose_backend

choose_backend()

import numpy as np
from rich.console import Console
from rich.table import Table

from sero_mj import HeadlessRenderer, Mirror
from sero_mj.data.record.formats import open_recording
from sero_mj.data.record.replay import Replay
from sero_mj.load import load_scene

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))  # for messages and publishers of tests
DOMAIN, RATE = 150, 1000
NAMES = [f"fr3_joint{i}" for i in range(1, 8)]
SCENE = f"""
[robots.fr3]
model = "fr3"
show_arrows = true
[sources.ros]
kind = "ros2"
domain = {DOMAIN}
[routes]
"fr3.joint_angles" = "ros.joint_angles"
"fr3.torques" = "ros.torques"
"""
PUBLISHER = f"""
import sys, time
sys.path.insert(0, {str(HERE.parent / "tests")!r})
from ros2_peer import *
domain = Domain({DOMAIN}, LOOPBACK)
participant = DomainParticipant({DOMAIN})
qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(100))
writer = DataWriter(participant, Topic(participant, "rt/joint_states", JointState), qos=qos)
while not writer.get_matched_subscriptions():
    time.sleep(0.01)
time.sleep(0.5)
names = {NAMES!r}
begin, count = time.perf_counter(), int(sys.argv[1])
for k in range(count):
    while time.perf_counter() < begin + k / {RATE}:
        time.sleep(1e-4)
    now = time.time_ns()
    stamp = Time(now // 10**9, now % 10**9)
    writer.write(JointState(Header(stamp, ""), names, [k * 1e-4] * 7, [0.0] * 7, [1.0] * 7))
time.sleep(0.5)
"""


def published(count: int) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-c", PUBLISHER, str(count)])


def spread(late: list[float]) -> tuple[str, str]:
    """Returns the median and the 99th percentile of latencies, ms."""
    if not late:
        return "", ""
    p50, p99 = np.percentile(np.array(late) * 1e3, (50, 99))
    return f"{p50:.2f}", f"{p99:.2f}"


def bare(count: int) -> tuple[int, list[float]]:
    """Receives messages with Cyclone DDS; returns the number of messages and latencies (s)."""
    from cyclonedds.core import Policy, Qos
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from ros2_peer import JointState

    from sero_mj.extensions.ros.dds import Participant

    participant = Participant("localhost", DOMAIN, "bench")
    inner = participant._participant
    topic = Topic(inner, "rt/joint_states", JointState)
    qos = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(256))
    reader = DataReader(inner, topic, qos=qos)
    publisher, late = published(count), []
    for message in reader.take_iter(timeout=3 * 10**9):
        stamp = message.header.stamp
        late.append(time.time() - stamp.sec - 1e-9 * stamp.nanosec)
        if len(late) == count:
            break
    publisher.wait()
    participant.close()
    return len(late), late


def ours(count: int, folder: Path, *, renders: bool) -> tuple[int, list[float]]:
    """Receives messages with a mirror; returns the number of messages and latencies (s).

    Latencies are from the time stamp to `MjData`. If `renders` is true, a thread renders 30 frames
    per second.
    """
    file = folder / "scene.toml"
    file.write_text(SCENE, encoding="utf-8")
    late: list[float] = []
    stop, came = threading.Event(), threading.Event()
    with Mirror(load_scene(file)) as mirror:
        source = mirror.sources["ros"]
        source.on_receive(came.set)

        def apply() -> None:
            while not stop.is_set():
                if came.wait(0.1):
                    came.clear()
                    mirror.advance()
                    packet = source.latest()
                    if packet is not None:
                        late.append(time.time() - float(packet.values["stamp"][0]))

        def render() -> None:
            with HeadlessRenderer(mirror.world, 640, 480) as renderer:
                while not stop.wait(1 / 30):
                    renderer.render(mirror.data)

        threads = [threading.Thread(target=apply)]
        threads += [threading.Thread(target=render)] if renders else []
        for thread in threads:
            thread.start()
        publisher = published(count)
        publisher.wait()
        stop.set()
        for thread in threads:
            thread.join()
        return source.counters.received, late


def replayed(path: Path) -> float:
    """Returns the speed of a replay relative to real time."""
    with Replay(file=path) as replay:
        begin = time.perf_counter()
        replay.advance_to(1e6)
        return replay.duration / (time.perf_counter() - begin)


def sought(path: Path) -> float:
    """Returns the duration of a seek in a bag, ms."""
    with open_recording(path) as recording:
        (name,) = recording.sources
        times = np.random.default_rng(0).uniform(0.0, recording.duration, 20)
        begin = time.perf_counter()
        for when in times:
            recording.last_before(name, float(when))
        return (time.perf_counter() - begin) / len(times) * 1e3


def main() -> None:
    from ros_tools import OLD_STORE, STORE, joint_state, write_bag

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0)
    count = int(parser.parse_args().seconds * RATE)
    table = Table("", "messages", "p50, ms", "p99, ms", title=f"{RATE} Hz, 7 joints")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        runs: dict[str, Callable[[], tuple[int, list[float]]]] = {
            "plain Cyclone DDS": lambda: bare(count),
            "to MjData": lambda: ours(count, folder, renders=False),
            "to MjData, rendering 30 frames/s": lambda: ours(count, folder, renders=True),
        }
        for title, measure in runs.items():
            came, late = measure()
            table.add_row(title, f"{came} of {count}", *spread(late))
        bags = Table("bag", "times real time", "seek, ms", title=f"replay, {RATE} Hz, 7 joints")
        for kind in ("mcap", "db3", "bag"):
            store = OLD_STORE if kind == "bag" else STORE
            entries = [
                (k * 10**6, joint_state(NAMES, np.ones(7), np.ones(7), np.ones(7), k, store))
                for k in range(20 * RATE)
            ]
            path = folder / ("drive.bag" if kind == "bag" else kind)
            write_bag(path, {"/joint_states": entries}, kind)
            bags.add_row(kind, f"{replayed(path):.1f}", f"{sought(path):.1f}")
    Console().print(table)
    Console().print(bags)


if __name__ == "__main__":
    main()
