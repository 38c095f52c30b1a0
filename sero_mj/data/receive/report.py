"""Reports what a source has received so far, by cause, for people and for programs."""

from __future__ import annotations

import time
from dataclasses import fields
from typing import Any

from ...base.errors import SourceError
from .intake import Counters
from .mailbox import age
from .source import Source

_SAME_DAY = 86_400.0  # s; stamps farther from the time count from something else
# Diagnoses by counter, in the order in which to check them.
MEANINGS = {
    "lost": "numbers that never came",
    "late": "after one with a higher number",
    "duplicates": "with a number that was there",
    "restarts": "the sender restarted",
    "wrong_size": "not as long as the structure says",
    "wrong_constant": "another number where the structure demands one",
    "wrong_checksum": "corrupted: another checksum than that of its bytes",
    "not_finite": "NaN or infinity where something would move",
    "not_frames": "a matrix that is no frame",
    "implausible": "a number beyond what a robot can have",
    "foreign": "from others than the sender that is named",
    "torn": "reads given up because the writer was in between",
    "blanked": "with values that are no data",
    "dropped": "dropped by the kernel, its buffer was full",
    "failures": "of reception, which then started again",
}


def report(source: Source) -> dict[str, Any]:
    """Counters, rate and age of a source, by name.

    Returns:
        every counter by its name, and `source`, `about`, `message` (what its packets are; empty for
        plain structures), `receiving`, `rate` (packets/s), `age` (s since the last good packet,
        None before the first), `jitter` and `delay` (s, None where the packets have no time stamp),
        `clock` (s by which the sender's clock is behind ours, with the time that the fastest packet
        took; None where its stamps are not of a clock), `good`, `trouble` (why no packets arrive,
        if known: missing shared memory, say), `error` (the last failure of reception; empty once
        packets arrive again), `controller` (what the last good packet says of the robot's
        controller, in words), `fault_age` (s since the last rejected packet, None for none).
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
    """A source's `error` for people, without the name of the source; empty for none."""
    error = source.error
    return error.reason if isinstance(error, SourceError) else str(error or "")


def _clock(source: Source) -> float | None:
    behind = source.timing.fastest + time.time() - time.monotonic()
    return behind if source.is_live and abs(behind) < _SAME_DAY else None


def describe(found: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Rows of a table: cause, count, and diagnosis; causes that did not occur are left out.

    Args:
        found: result of `report`.
    """
    rows = []
    why = f": {found['trouble']}" if found["trouble"] else ""
    if found["age"] is None:
        rows.append(("state", "silent", f"no good packet yet{why}"))
    elif found["receiving"]:
        delay = found["delay"]
        slow = f", {delay * 1e3:.2f} ms behind the fastest" if delay is not None else ""
        jitter = f"jitter {found['jitter'] * 1e3:.3f} ms{slow}"
        rows.append(("state", f"{found['rate']:.1f}/s", jitter))
    else:
        rows.append(("state", "quiet", f"no good packet for {found['age']:.1f} s{why}"))
    if found["error"]:
        rows.append(("error", "", found["error"]))
    if found["controller"]:
        rows.append(("controller", "", found["controller"]))
    if found["clock"] is not None:
        behind = found["clock"] * 1e3
        what = f"{abs(behind):.1f} ms {'behind' if behind >= 0.0 else 'ahead of'} ours"
        rows.append(("clock", "", f"the sender's is {what}, if the fastest packet took no time"))
    rows.append(("received", str(found["received"]), f"{found['good']} of them applied"))
    meanings = dict(MEANINGS)
    if found["message"]:
        meanings["wrong_size"] = f"no {found['message']} that can be used"
    if found["wrong_size"] or found["wrong_constant"] or found["wrong_checksum"]:
        meanings["lost"] += ", or that of a packet below could not be read"
    rows += [(name, str(found[name]), why) for name, why in meanings.items() if found[name]]
    if found["senders"] > 1:
        rows.append(("senders", str(found["senders"]), "at once; sender = ... chooses one"))
    if found["last_fault"]:
        rows.append(("last fault", "", found["last_fault"]))
    return rows
