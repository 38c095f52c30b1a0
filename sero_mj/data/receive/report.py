"""Reports of the packets that a source has received, as data and as text."""

from __future__ import annotations

import time
from dataclasses import fields
from typing import Any

from ...base.errors import SourceError
from .intake import Counters
from .mailbox import age
from .source import Source

_MAX_CLOCK_DIFFERENCE = 86_400.0  # s; at larger differences, time stamps have another epoch
# Descriptions of counters, in the order in which users should check them.
MEANINGS = {
    "lost": "missing sequence numbers",
    "late": "arrived after a packet with a higher number",
    "duplicates": "repeated sequence number",
    "restarts": "the sender restarted",
    "wrong_size": "the size differs from that of the structure",
    "wrong_constant": "a number differs from the constant in the structure",
    "wrong_checksum": "corrupted: wrong checksum",
    "not_finite": "NaN or infinity in a value that moves something",
    "not_frames": "a matrix is not a rigid frame",
    "implausible": "a number is beyond the plausible range",
    "foreign": "not from the configured sender",
    "torn": "unsuccessful reads, because the writer was always writing",
    "blanked": "applied, with missing data",
    "dropped": "dropped by the kernel, because its buffer was full",
    "failures": "failures of reception, which then restarted",
}


def report(source: Source) -> dict[str, Any]:
    """Returns the state of a source, as a dictionary.

    The keys are the fields of `Counters`, and the following:

    - `source`, `about`: name and description of the source
    - `message`: kind of the messages of the source; empty for plain packets
    - `receiving`: whether packets arrive
    - `good`: number of valid packets
    - `rate`: packets per second
    - `age`: time in seconds since the last valid packet; None before the first packet
    - `jitter`, `delay`: see `Timing`; `delay` is None if packets have no time stamp
    - `clock`: offset in seconds of the local clock from the sender's clock, plus the transmission
      time of the fastest packet; None if time stamps are not times of day
    - `trouble`: reason why no packets arrive; empty if unknown
    - `error`: last failure of reception; empty once packets arrive again
    - `controller`: description of the robot controller's state
    - `fault_age`: time in seconds since the last malformed packet; None if there was none
    """
    counters, timing = source.counters, source.timing
    latest = source.latest()
    since = age(latest, source.now())
    return {
        "source": source.name,
        "about": source.about,
        "message": source.layout.message,
        "receiving": source.receiving,
        "good": source.receive_trigger,
        "rate": timing.rate if source.receiving else 0.0,
        "age": since if since < float("inf") else None,
        "jitter": timing.jitter,
        "delay": timing.delay if source.time else None,
        "clock": _clock(source),
        "trouble": source.trouble,
        "error": error_text(source),
        "controller": "" if latest is None else source.original.describe_link(latest.values),
        "malformed": counters.malformed,
        "fault_age": source.now() - counters.last_fault_time if counters.malformed else None,
        **{field.name: getattr(counters, field.name) for field in fields(Counters)},
    }


def error_text(source: Source) -> str:
    """Returns the message of a source's `error` without the source name; empty if there is none."""
    error = source.error
    return error.reason if isinstance(error, SourceError) else str(error or "")


def _clock(source: Source) -> float | None:
    behind = source.timing.fastest + time.time() - time.monotonic()
    return behind if source.is_live and abs(behind) < _MAX_CLOCK_DIFFERENCE else None


def describe(found: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Converts a `report` to the rows of a table with the columns cause, count and description."""
    rows = []
    why = f": {found['trouble']}" if found["trouble"] else ""
    if found["age"] is None:
        rows.append(("state", "silent", f"no valid packet yet{why}"))
    elif found["receiving"]:
        delay = found["delay"]
        slow = f", {delay * 1e3:.2f} ms later than the fastest packet" if delay is not None else ""
        jitter = f"jitter {found['jitter'] * 1e3:.3f} ms{slow}"
        rows.append(("state", f"{found['rate']:.1f}/s", jitter))
    else:
        rows.append(("state", "quiet", f"no valid packet for {found['age']:.1f} s{why}"))
    if found["error"]:
        rows.append(("error", "", found["error"]))
    if found["controller"]:
        rows.append(("controller", "", found["controller"]))
    if found["clock"] is not None:
        behind = found["clock"] * 1e3
        pace = "slow" if behind >= 0.0 else "fast"
        what = f"{abs(behind):.1f} ms {pace} compared with the local clock"
        rows.append(("clock", "", f"the sender's clock is {what} (assuming no transmission time)"))
    rows.append(("received", str(found["received"]), f"{found['good']} applied"))
    meanings = dict(MEANINGS)
    if found["message"]:
        meanings["wrong_size"] = f"not a valid {found['message']}"
    if found["wrong_size"] or found["wrong_constant"] or found["wrong_checksum"]:
        meanings["lost"] += ", or numbers of malformed packets"
    rows += [(name, str(found[name]), why) for name, why in meanings.items() if found[name]]
    if found["senders"] > 1:
        how = "concurrent senders; set sender = ... to choose one"
        rows.append(("senders", str(found["senders"]), how))
    if found["last_fault"]:
        rows.append(("last fault", "", found["last_fault"]))
    return rows
