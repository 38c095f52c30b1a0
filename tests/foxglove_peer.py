"""A server of `foxglove-sdk` that behaves like foxglove_bridge: `python foxglove_peer.py PORT`.

The server answers each line of JSON with a line. `topic`, `kind` and `encoding` open a channel.
`wait` waits until there is a subscriber. `data` (hexadecimal) publishes a message. `close` closes
the channel. `rate` publishes `count` messages with their send time in bytes 4 to 11 of `data`.
"""

from __future__ import annotations

import json
import struct
import sys
import threading
import time
from typing import Any

import foxglove
from foxglove.websocket import ServerListener


class Subscriptions(ServerListener):
    """The channels to which clients have subscribed; unsubscriptions may arrive late."""

    def __init__(self) -> None:
        self.channels: set[int] = set()
        self.changed = threading.Condition()

    def on_subscribe(self, client: Any, channel: Any) -> None:
        with self.changed:
            self.channels.add(channel.id)
            self.changed.notify_all()

    def wait_for(self, channel: int) -> bool:
        with self.changed:
            return self.changed.wait_for(lambda: channel in self.channels, 5.0)

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        with self.changed:
            self.channels.discard(channel.id)


def publish(channel: foxglove.Channel, data: bytes, rate: float = 0.0, count: int = 1) -> None:
    begin = time.perf_counter()
    for k in range(count):
        if rate:
            time.sleep(max(begin + k / rate - time.perf_counter(), 0.0))
            now = time.time_ns()
            data = data[:4] + struct.pack("<iI", now // 10**9, now % 10**9) + data[12:]
        channel.log(data)


def main() -> None:
    subscriptions = Subscriptions()
    server = foxglove.start_server(
        host="127.0.0.1", port=int(sys.argv[1]), server_listener=subscriptions
    )
    print(server.port, flush=True)
    channels: dict[str, foxglove.Channel] = {}
    for line in sys.stdin:
        command = json.loads(line)
        topic = command["topic"]
        if command.get("close"):
            channels.pop(topic).close()
        elif topic not in channels:
            kind = command.get("kind", "sensor_msgs/msg/JointState")
            schema = foxglove.Schema(name=kind, encoding="ros2msg", data=b"# not needed")
            encoding = command.get("encoding", "cdr")
            channels[topic] = foxglove.Channel(topic, schema=schema, message_encoding=encoding)
        done = True
        if command.get("wait"):
            done = subscriptions.wait_for(channels[topic].id())
        if "data" in command:
            numbers = {key: command[key] for key in ("rate", "count") if key in command}
            publish(channels[topic], bytes.fromhex(command["data"]), **numbers)
        print("done" if done else "nobody has subscribed", flush=True)
    server.stop()


if __name__ == "__main__":
    main()
