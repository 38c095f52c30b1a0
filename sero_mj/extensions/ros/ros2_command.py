"""`sero-mj ros2`: what a network of ROS 2 publishes, and what could show it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Literal

from pydantic import Field

from ...base.options import Option, positional
from ...cli.arguments import command, print_json, print_table
from ...cli.shared_options import JsonOptions

ORDER = 29  # in the help of `sero-mj`

_EPILOG = """\
It needs no ROS: pip install 'sero-mj[ros2]'.

examples:
  sero-mj ros2 list                        this machine, domain ROS_DOMAIN_ID or 0
  sero-mj ros2 list --host subnet          whatever multicast finds
  sero-mj view ros2://                     the robot that is described there
  sero-mj view 'ros2://192.168.0.3:42?robot=fr3'   on one machine, in domain 42

See also: docs/extensions/ros.md
"""


class Ros2Options(JsonOptions):
    """List the topics of ROS 2, their rates, and the robots that they could move.

    Attributes:
        action: what is done.
        host: where publishers are: localhost, subnet (found by multicast), or an address.
        domain: ROS_DOMAIN_ID of the publishers; default that of the environment, else 0.
        duration: how long to listen, s.
    """

    action: Annotated[Literal["list"], positional("list")] = "list"
    host: Annotated[str, Option("HOST")] = "localhost"
    domain: Annotated[int | None, Field(ge=0, le=232), Option("N")] = None
    duration: Annotated[float, Field(gt=0.0, le=3600.0), Option("S")] = 2.0


def run(options: Ros2Options) -> int:
    """Lists; returns 0, or 1 if there is nothing."""
    from .dds import LOCALHOST, domain_number
    from .network import list_topics

    topics = list_topics(options.host, options.domain, options.duration)
    if options.as_json:
        print_json([{**asdict(topic), "robots": topic.robots} for topic in topics])
        return 0 if topics else 1
    if not topics:
        where = f"domain {domain_number(options.domain)} of {options.host}"
        hint = "; --host subnet looks on the network" if options.host == LOCALHOST else ""
        print(f"nobody publishes in {where}, within {options.duration:g} s{hint}")
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
            moves = "sero-mj view ros2://" + _rest(options, topic.name)
        table.add_row(topic.name, topic.kind, str(topic.publishers), rate, moves)
    print_table(table)
    return 0


def _rest(options: Ros2Options, description: str) -> str:
    namespace = description.removesuffix("/robot_description")
    host = "" if options.host == "localhost" and options.domain is None else options.host
    return host + ("" if options.domain is None else f":{options.domain}") + namespace


add_to = command("ros2", run, Ros2Options, _EPILOG)
