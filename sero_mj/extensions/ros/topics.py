"""Lists the topics and robots of ROS 2 networks for commands."""

from __future__ import annotations

from dataclasses import asdict

from ...cli.arguments import print_json, print_table
from .dds import LOCALHOST, domain_number
from .described_scene import scene_of_network
from .network import SCHEME, Address, list_topics

__all__ = ["print_topics", "scene_of_network"]


def print_topics(text: str, duration: float, *, as_json: bool) -> int:
    """Prints the topics of a ROS 2 network, their rates, and the robots that they can move.

    Returns exit status 1 if nothing is published.

    Args:
        text: address of the network, `ros2://HOST:DOMAIN`.
        duration: time in seconds to listen.
    """
    address = Address.parse(text)
    topics = list_topics(address.host, address.domain, duration)
    if as_json:
        print_json([{**asdict(topic), "robots": topic.robots} for topic in topics])
        return 0 if topics else 1
    if not topics:
        where = f"ROS 2 domain {domain_number(address.domain)} on {address.host}"
        hint = f"; use {SCHEME}subnet to search the network" if address.host == LOCALHOST else ""
        print(f"no publisher in {where} (waited {duration:g} s){hint}")
        return 1
    from rich.table import Table

    table = Table(box=None)
    for title, justify in (("topic", "left"), ("type", "left"), ("publishers", "right"),
                           ("per s", "right"), ("moves", "left")):  # fmt: skip
        table.add_column(title, justify=justify)  # type: ignore[arg-type]
    for topic in topics:
        rate = "" if topic.rate is None else f"{topic.rate:.1f}"
        moves = ", ".join(topic.robots) or (f"{len(topic.joints)} joints" if topic.joints else "")
        if topic.name.endswith("/robot_description"):
            moves = f"sero-mj view {SCHEME}{_rest(address, topic.name)}"
        table.add_row(topic.name, topic.kind, str(topic.publishers), rate, moves)
    print_table(table)
    return 0


def _rest(address: Address, description: str) -> str:
    namespace = description.removesuffix("/robot_description")
    host = "" if address.host == LOCALHOST and address.domain is None else address.host
    return host + ("" if address.domain is None else f":{address.domain}") + namespace
