"""A zenoh router and publisher that behave like rmw_zenoh: `python zenoh_peer.py PORT [MODE]`.

It answers each line of JSON with a line. `topic` and `kind` (in `domain`) declare a publisher with
its liveliness token. `silent` omits the token. `kept` stores the last message for later readers.
`wait` waits until there is a reader. `data` (hexadecimal) publishes a message. `rate` publishes
`count` messages with their send time in bytes 4 to 11 of `data`.
"""

from __future__ import annotations

import json
import struct
import sys
import time
from typing import Any

import zenoh
from zenoh import ext

GID = bytes(range(16))
HASH = "RIHS01_" + 64 * "0"


def opened(port: int, mode: str) -> Any:
    configuration = zenoh.Config()
    for key, value in {
        "mode": mode,
        "listen/endpoints": [f"tcp/127.0.0.1:{port}"],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "timestamping/enabled": True,
    }.items():
        configuration.insert_json5(key, json.dumps(value))
    return zenoh.open(configuration)


def attached(number: int, gid: bytes) -> bytes:
    """Returns the attachment of rmw_zenoh to message `number`, in zenoh's serialization format."""
    parts = ("sequence_number", number), ("source_timestamp", time.time_ns())
    begin = b"".join(
        bytes([len(name)]) + name.encode() + struct.pack("<q", value) for name, value in parts
    )
    return begin + b"\x0asource_gid" + bytes([len(gid)]) + gid


def main() -> None:
    port, mode = int(sys.argv[1]), (sys.argv[2:] or ["router"])[0]
    session = opened(port, mode)
    print(port, flush=True)
    publishers: dict[str, Any] = {}
    tokens = []
    for line in sys.stdin:
        command = json.loads(line)
        topic, domain = command["topic"], command.get("domain", 0)
        package, _, name = command.get("kind", "sensor_msgs/msg/JointState").rpartition("/")
        kind = f"{package.replace('/', '::')}::dds_::{name}_"
        key = f"{domain}{topic}/{kind}/{HASH}"
        if key not in publishers:
            if command.get("kept"):
                publishers[key] = ext.declare_advanced_publisher(
                    session, key, cache=ext.CacheConfig(1), publisher_detection=True
                )
            else:
                publishers[key] = session.declare_publisher(key)
            if not command.get("silent"):
                mangled = topic.replace("/", "%")
                token = f"@ros2_lv/{domain}/{session.zid()}/0/{len(tokens)}/MP/%/%/arm/{mangled}"
                tokens.append(
                    session.liveliness().declare_token(f"{token}/{kind}/{HASH}/::,10:,:,:,,")
                )
        publisher, done = publishers[key], True
        if command.get("wait"):
            deadline = time.monotonic() + 5.0
            while not (done := publisher.matching_status.matching) and time.monotonic() < deadline:
                time.sleep(1e-3)
        if "data" in command:
            data, rate = bytes.fromhex(command["data"]), command.get("rate", 0.0)
            gid = bytes.fromhex(command.get("gid", GID.hex()))
            begin = time.perf_counter()
            for k in range(command.get("count", 1)):
                if rate:
                    time.sleep(max(begin + k / rate - time.perf_counter(), 0.0))
                    now = time.time_ns()
                    data = data[:4] + struct.pack("<iI", now // 10**9, now % 10**9) + data[12:]
                publisher.put(data, attachment=attached(k, gid) if gid else None)
        print("done" if done else "nobody reads", flush=True)
    session.close()


if __name__ == "__main__":
    main()
