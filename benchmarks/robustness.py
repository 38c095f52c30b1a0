"""Runs fuzzing, faults and a long run, and writes the results to out/robustness/index.html.

The long form also writes docs/attacks.md.

    make robustness                              a run of 10 minutes (--seconds 86400 for a day)
    .venv/bin/python benchmarks/robustness.py --quick      the short form, as in CI

The fuzzing and fault tests in the tables below are run with a seed (`--seed`, default: random), and
the tests and cases of Hypothesis are counted. The page also lists the limits in the code. The
script fails if a test fails, or if the long run loses packets or its memory grows. It requires
Linux and a C compiler. Tests that need a browser are skipped if there is no browser.
"""

from __future__ import annotations

import argparse
import base64
import html
import io
import os
import platform
import random
import re
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "out" / "robustness"
QUICK_SECONDS = 20.0
WARM = 0.25  # share of the long run in which history and caches fill, so that growth is ignored
MOST_GROWTH = 1.25  # maximum ratio of memory at the end to memory after this time
RECEIVED = 0.999  # minimum share of received packets


@dataclass(frozen=True)
class Target:
    """A target of attacks or faults, and its tests.

    Attributes:
        title: description of the target.
        tests: pytest names of the tests below tests/.
        in_quick: whether the short form runs the tests.
    """

    title: str
    tests: tuple[str, ...]
    in_quick: bool = True


FUZZED = (
    Target("files that request to run programs", ("test_trust.py",)),
    Target("packets with arbitrary bytes", (
        "test_hostile_packets.py",
        "test_implausible.py",
        "test_structure.py::test_any_float32_is_applied_or_counted_as_not_finite",
        "test_matrices.py::test_any_bytes_are_applied_whole_or_counted",
        "test_matrices.py::test_any_numbers_are_applied_or_blanked_or_counted",
        "extensions/ros/test_joined_packets.py::test_any_bytes_are_applied_or_counted",
    )),
    Target("finite but implausible numbers in packets", (
        "test_implausible.py",
    )),
    Target("messages of KUKA FRI, UR RTDE, Franka FCI and foxglove_bridge", (
        "extensions/fri/test_fri_iiwa.py::test_random_bytes_are_a_packet_or_an_error",
        "extensions/fri/test_fri_iiwa.py::test_damaged_message_is_a_packet_or_an_error",
        "extensions/rtde/test_rtde.py::test_random_bytes_end_a_connection_and_nothing_else",
        "extensions/franka/test_franka.py::test_random_bytes_end_a_connection_and_nothing_else",
        "extensions/ros/test_foxglove.py::test_next_message_is_read_after_any_bytes",
    )),
    Target("text of structures and routes", (
        "test_structure.py::test_arbitrary_text_raises_only_structure_errors",
        "test_route.py::test_any_text_is_a_route_or_a_problem",
        "test_route_checks.py::test_any_text_is_a_route_or_a_problem",
        "test_expression.py::test_any_text_is_evaluated_or_rejected",
    )),
    Target("recordings (MCAP)", (
        "test_recording_faults.py::test_truncated_recording_has_the_packets_before_the_cut",
        "test_recording_faults.py::test_damage_never_creates_packets",
        "test_hostile_recordings.py",
        "extensions/ros/test_bags.py::test_damaged_bags_are_errors_or_end_early",
    )),
    Target("TOML", (
        "test_paths.py::test_any_tables_are_read_or_rejected_as_a_declaration",
        "test_paths.py::test_any_text_is_read_or_rejected_as_a_declaration",
        "test_paths.py::test_any_bytes_are_read_or_rejected_as_a_declaration",
        "test_hostile_files.py",
    )),
    Target("URDF", ("test_urdf.py::test_mutated_files_raise_only_declaration_errors",)),
    Target("MJCF", ("test_mjcf_robot.py::test_mutated_files_raise_only_sero_errors",)),
    Target("X3D and VRML", (
        "extensions/x3d/test_vrml.py::test_mutated_file_is_read_or_reported",
        "extensions/x3d/test_vrml.py::test_long_invalid_text_takes_linear_time",
        "extensions/x3d/test_vrml.py::test_nested_uses_and_protos_terminate",
    )),
    Target("meshes", (
        "test_mesh_files.py::test_damaged_files_raise_only_declaration_errors",
        "test_mesh_files.py::test_invalid_meshes_are_rejected",
    )),
    Target("WebSocket messages of a page", (
        "test_web_host.py::test_page_continues_after_any_browser_messages",
        "test_dom_widgets.py::test_widgets_return_valid_values_for_any_browser_input",
        "test_dom_widgets.py::test_unknown_widget_ids_are_not_stored",
        "test_web_guard.py::test_too_long_messages_end_their_connection",
        "test_web_guard.py::test_malformed_requests_are_rejected",
        "test_web_host.py::test_no_view_in_a_link_ends_the_page",
        "test_web_host.py::test_too_long_message_ends_its_connection_only",
        "test_web_host.py::test_browser_that_sends_too_much_is_throttled",
        "test_web_host.py::test_number_of_browsers_is_limited",
    )),
    Target("access to a page without its token or without control", (
        "test_web_guard.py::test_page_requires_its_token_and_its_files_do_not",
        "test_web_guard.py::test_no_other_process_can_listen_on_the_localhost_addresses",
        "test_web_guard.py::test_another_users_server_on_another_port_learns_nothing",
        "test_web_guard.py::test_website_in_the_browser_of_the_user_gets_nothing",
        "test_web_host.py::test_only_the_browser_in_control_changes_anything",
        "test_web_host.py::test_page_sends_nothing_without_the_token",
        "test_web_start.py::test_only_the_browser_in_control_opens_anything",
        "test_web_start.py::test_browser_that_loses_control_during_an_upload_uploads_nothing",
        "test_web_start.py::test_other_sites_and_requests_without_a_token_are_rejected",
    )),
    Target("control characters from files in terminal output", ("test_terminal.py",)),
    Target("uploads", (
        "test_web_start.py::test_rejected_uploads_leave_nothing_and_full_storage_is_reported",
        "test_start_page.py::test_no_path_leads_out_of_the_folder",
        "test_start_page.py::test_uploads_are_stored_completely_or_not_at_all",
    )),
    Target("shared memory and shared files", (
        "test_shm.py::test_block_can_be_resized_while_it_is_read",
        "test_shm_writers.py::test_torn_packets_are_never_applied",
        "test_shared_arrays.py::test_array_is_read_once_and_whole_or_not_at_all",
        "test_view_state.py::test_toggles_round_trip_through_text",
    )),
    Target("random input to a page and a window", (
        "test_web_monkey.py", "test_window_monkey.py",
    ), in_quick=False),
)  # fmt: skip

FAULTS = (
    Target("Ctrl+C, SIGTERM or kill -9 while started programs are running", (
        "test_child_process.py",
    )),
    Target("kill -9 of other processes", (
        "test_recorder.py::test_killed_process_leaves_a_readable_file",
        "test_shm_writers.py::test_writer_killed_during_a_write_is_replaced",
        "extensions/ros/test_ros2.py::test_killed_driver_is_replaced_by_another_one",
        "extensions/sweeps/test_sweep.py::test_killed_process_loses_its_variant_only",
        "test_viewer_process.py::"
        "test_second_viewer_replaces_the_first_and_a_dead_one_does_not_stop_the_loop",
        "test_web_guard.py::test_terminated_page_leaves_no_files",
    )),
    Target("exceptions while receiving packets", (
        "test_receiving_thread.py",
    )),
    Target("host names with several addresses, with slow ones or with none", (
        "extensions/test_connecting.py",
    )),
    Target("systems without POSIX functions", (
        "test_platforms.py",
    )),
    Target("full disk", (
        "test_recorder.py::test_full_disk_ends_the_recording_with_an_error",
        "test_recording_faults.py::"
        "test_full_disk_ends_the_recording_and_leaves_a_readable_file",
        "test_recording_faults.py::test_full_disk_at_the_start_is_reported",
    )),
    Target("lost network", (
        "extensions/rtde/test_rtde.py::test_peer_that_disconnects_is_connected_again",
        "extensions/franka/test_franka.py::test_robot_that_disconnects_is_connected_again",
        "extensions/ros/test_foxglove.py::test_reason_for_a_closed_connection_is_reported",
        "extensions/fri/test_fri_controller.py::test_network_faults_are_reproducible_by_seed",
        "test_status_command.py::test_source_that_went_silent_is_reported",
    )),
    Target("clock jumps", (
        "test_udp_lossless.py::test_arrivals_are_ordered_when_the_wall_clock_is_set",
        "test_udp_lossless.py::test_time_stamps_show_jitter_and_restarts",
    )),
    Target("suspended process", (
        "test_viewer_process.py::test_viewer_is_shown_without_calls_and_no_call_waits_for_it",
        "extensions/rtde/test_rtde_robot.py::test_sleeping_client_is_silent_until_it_answers_again",
    )),
)  # fmt: skip

# Limited item, module of sero_mj, constant, and unit.
LIMITS = (
    ("TOML file", "base.toml_file", "_MAX_BYTES", "bytes"),
    ("URDF file", "robots.importers.urdf", "_MAX_BYTES", "bytes"),
    ("movable joints of a URDF", "robots.importers.urdf", "_MAX_JOINTS", ""),
    ("links of a URDF", "robots.importers.urdf", "_MAX_LINKS", ""),
    ("MJCF file", "robots.importers.mjcf_file", "_MAX_BYTES", "bytes"),
    ("bodies, geoms and sites of an MJCF file", "robots.importers.mjcf_file", "_MAX_ELEMENTS", ""),
    ("mesh or texture of an MJCF file", "robots.importers.mjcf_file", "MAX_ASSET_BYTES", "bytes"),
    ("X3D or VRML file, uncompressed", "extensions.x3d.vrml", "MAX_BYTES", "bytes"),
    ("mesh that MuJoCo reads", "robots.importers.mesh_files", "MAX_MESH_BYTES", "bytes"),
    ("any other mesh", "robots.importers.mesh_files", "MAX_CONVERTED_BYTES", "bytes"),
    ("chunk of a recording, uncompressed", "data.record.mcap_reader", "MAX_CHUNK_BYTES", "bytes"),
    ("camera file", "extensions.photo.camera_file", "_MAX_BYTES", "bytes"),
    ("packet", "data.receive.language", "MAX_PACKET_BYTES", "bytes"),
    ("queued packets of a lossless source", "data.receive.mailbox", "QUEUE_BYTES", "bytes"),
    ("message from a browser", "viewer.web.messages", "MAX_BYTES", "bytes"),
    ("messages per second from a browser", "viewer.web.browsers", "_MAX_PER_SECOND", ""),
    ("queued messages from browsers", "viewer.web.browsers", "_MAX_QUEUED", ""),
    ("browsers connected to a page", "viewer.web.browsers", "_MAX_BROWSERS", ""),
    ("total size of uploaded files on a server", "viewer.web.uploads", "MAX_BYTES", "bytes"),
    ("number of uploaded files on a server", "viewer.web.uploads", "MAX_FILES", ""),
    ("saved view", "viewer.session.view_state", "_MAX_CHARACTERS", "characters"),
    ("log of a run", "simulate.simulation", "MAX_BYTES", "bytes"),
    ("duration of a simulated run", "simulate.scenario", "_MAX_DURATION", "s"),
    ("history of a live view", "viewer.session.clock", "_MAX_STATE_BYTES", "bytes"),
)


@dataclass
class Outcome:
    """The results of the tests of a target."""

    title: str
    tests: Counter[str] = field(default_factory=Counter)  # numbers of passed, skipped, failed tests
    cases: int = 0  # number of Hypothesis cases
    seconds: float = 0.0
    failed: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)


def run_tests(kind: str, targets: Sequence[Target], seed: int, profile: str) -> list[Outcome]:
    """Runs the tests of all targets in one process of pytest.

    Raises:
        SystemExit: pytest did not run, or there is no test with a name.
    """
    junit = OUT / f"{kind}.xml"
    junit.unlink(missing_ok=True)
    names = [f"tests/{test}" for target in targets for test in target.tests]
    command = [
        sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *dict.fromkeys(names),
        f"--junit-xml={junit}", f"--hypothesis-seed={seed}", f"--hypothesis-profile={profile}",
        "--hypothesis-show-statistics",
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    (OUT / f"{kind}.txt").write_text(done.stdout + done.stderr)
    if done.returncode not in (0, 1) or not junit.exists():
        raise SystemExit(
            f"pytest ended with status {done.returncode}:\n{(done.stdout + done.stderr)[-2000:]}"
        )
    made = cases_made(done.stdout)
    found = [*ET.parse(junit).iter("testcase")]
    return [outcome_of(target, found, made) for target in targets]


def cases_made(text: str) -> dict[str, int]:
    """Returns the number of Hypothesis cases of each test by its pytest name.

    Args:
        text: output of pytest with `--hypothesis-show-statistics`.
    """
    made: dict[str, int] = {}
    name = ""
    for line in text.splitlines():
        if head := re.match(r"tests/(\S+\.py::.+):$", line):
            name = head[1].partition("[")[0]
        elif name and (counted := re.search(r"(\d+) passing, (\d+) failing", line)):
            made[name] = made.get(name, 0) + int(counted[1]) + int(counted[2])
    return made


def outcome_of(target: Target, found: Sequence[ET.Element], made: dict[str, int]) -> Outcome:
    """Returns the results of the tests of a target.

    Args:
        target: target with its tests.
        found: `testcase` elements of a JUnit file.
        made: number of Hypothesis cases by test, from `cases_made`.
    """
    outcome = Outcome(target.title)
    for case in found:
        module = case.get("classname", "").removeprefix("tests.")
        file = f"{module.replace('.', '/')}.py"
        name = f"{file}::{case.get('name', '').partition('[')[0]}"
        if file not in target.tests and name not in target.tests:
            continue
        tags = {element.tag for element in case}
        what = "failed" if tags & {"failure", "error"} else "passed"
        what = "skipped" if "skipped" in tags else what
        outcome.tests[what] += 1
        outcome.seconds += float(case.get("time", "0"))
        if what == "failed":
            outcome.failed.append(f"{file}::{case.get('name')}")
        if what == "skipped":
            outcome.skipped.append(str(case[0].get("message", "")))
    outcome.cases = sum(
        count for name, count in made.items()
        if name in target.tests or name.partition("::")[0] in target.tests
    )  # fmt: skip
    return outcome


def grown(rows: Sequence[dict[str, Any]], key: str) -> float:
    """Returns the ratio of a quantity at the end of a long run to its value after the warm-up.

    Both values are medians over some seconds.
    """
    import numpy as np

    few = max(len(rows) // 10, 3)
    start = int(WARM * len(rows))
    values = [float(row[key]) for row in rows]
    return float(np.median(values[-few:]) / np.median(values[start : start + few]))


def problems_of(rows: Sequence[dict[str, Any]], sent: int, judged: bool) -> list[str]:
    """Returns the problems of a long run.

    Args:
        rows: measurements from `soak`.
        sent: number of sent packets.
        judged: whether the run was long enough to evaluate memory growth.
    """
    found = []
    received = int(rows[-1]["received"])
    if received < RECEIVED * sent:
        found.append(f"received {received} of {sent} packets; expected {RECEIVED:.1%}")
    for key in ("handles", "threads"):
        if rows[-1][key] > rows[0][key]:
            found.append(f"{key}: {rows[0][key]} at the start, {rows[-1][key]} at the end")
    if judged and (growth := grown(rows, "memory")) > MOST_GROWTH:
        found.append(f"memory grew by a factor of {growth:.2f}; expected at most {MOST_GROWTH}")
    return found


def picture_of(rows: Sequence[dict[str, Any]]) -> str:
    """Plots memory, handles, threads and latencies over time; returns a data URL of the image."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    times = [row["time"] for row in rows]
    figure, axes = plt.subplots(3, 1, figsize=(8, 6.5), sharex=True, layout="constrained")
    axes[0].plot(times, [row["memory"] for row in rows])
    axes[0].set(ylabel="memory, MiB", ylim=(0, None))
    for key in ("handles", "threads"):
        axes[1].plot(times, [row[key] for row in rows], label=key)
    axes[1].set(ylabel="number", ylim=(0, None))
    for key in ("p50", "p99"):
        values = [float("nan") if row[key] is None else row[key] for row in rows]
        axes[2].plot(times, values, label=f"{key[1:]} %")
    axes[2].set(ylabel="packet to state, ms", yscale="log", xlabel="time, s")
    for each in axes[1:]:
        each.legend(loc="upper left", frameon=False)
    for each in axes:
        each.grid(alpha=0.3)
    made = io.BytesIO()
    figure.savefig(made, format="png", dpi=110)
    plt.close(figure)
    (OUT / "soak.png").write_bytes(made.getvalue())
    return f"data:image/png;base64,{base64.b64encode(made.getvalue()).decode()}"


def limit_text(value: float, unit: str) -> str:
    """Returns a limit with its unit as text."""
    if unit == "bytes":
        return f"{value / 1e6:,.0f} MB" if value >= 1e6 else f"{value:,.0f} bytes"
    return f"{value:,.0f} {unit}".strip()


def limits() -> list[tuple[str, str]]:
    """Returns the limited items and their limits as texts."""
    return [
        (what, limit_text(getattr(import_module(f"sero_mj.{module}"), name), unit))
        for what, module, name, unit in LIMITS
    ]


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Returns an HTML table."""
    cells = "".join(f"<th>{html.escape(cell)}</th>" for cell in head)
    body = "".join(
        f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>" for row in rows
    )
    return f"<table><tr>{cells}</tr>{body}</table>"


OUTCOME_HEAD = ("target", "tests", "Hypothesis cases", "outcome")


def outcome_cells(outcome: Outcome) -> list[str]:
    """Returns the cells of a target for the columns `OUTCOME_HEAD`."""
    return [
        outcome.title,
        str(sum(outcome.tests.values())),
        f"{outcome.cases:,}" if outcome.cases else "",
        ", ".join(f"{count} {what}" for what, count in sorted(outcome.tests.items())),
    ]


def outcomes_table(outcomes: Sequence[Outcome]) -> str:
    """Returns an HTML table of targets with their results."""
    rows = [
        [
            *outcome_cells(each),
            f"{each.seconds:.1f} s",
            "; ".join([*each.failed, *dict.fromkeys(each.skipped)]),
        ]
        for each in outcomes
    ]
    return table([*OUTCOME_HEAD, "time", "failed or skipped tests"], rows)


_DOCS = """# Attacks and faults

This page lists the attacks and faults that sero-mj is tested against, and the limits that it
enforces. `make robustness` runs the tests and rewrites this page. The test of an attack fails if
sero-mj exits, hangs, uses more and more memory, runs a program or applies a wrong value.
Hypothesis generates the cases, and the same seed always generates the same cases.

{about}; seed {seed}.

## Attacks

{fuzzed}

## Faults

{faults}

## A long run

{soak}

## Limits

sero-mj rejects an item that exceeds a limit with a message that states its size and the limit.
If a packet queue or a history is full, the oldest entries are dropped.

{limits}
"""


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Returns a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', '/') for cell in row)} |" for row in lines)


def outcomes_markdown(outcomes: Sequence[Outcome]) -> str:
    """Returns a Markdown table of targets with their results."""
    return markdown(OUTCOME_HEAD, [outcome_cells(each) for each in outcomes])


_PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>Robustness of sero-mj</title>
<style>
body {{ font: 15px/1.45 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto;
padding: 0 1rem }}
table {{ border-collapse: collapse }} td, th {{ text-align: left; padding: .25rem .8rem .25rem 0;
border-bottom: 1px solid #ddd; vertical-align: top }} td {{ white-space: nowrap }}
td:last-child {{ white-space: normal }} img {{ max-width: 100% }} .bad {{ color: #a00 }}
</style>
<h1>Robustness of sero-mj</h1>
<p>{about}</p>
<p class="{state}">{verdict}</p>
<h2>Fuzzing</h2><p>Seed {seed}: <code>make robustness SEED={seed}</code> repeats the cases.</p>
{fuzzed}
<h2>Faults</h2>{faults}
<h2>A long run</h2><p>{soak}</p>
<img src="{picture}" alt="memory, handles, threads and latencies over time">
<h2>Limits</h2><p>sero-mj rejects an item that exceeds a limit with a message that states its size
and the limit. If a packet queue or a history is full, the oldest entries are dropped.</p>
{limits}
</html>
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--seconds", type=float, help="duration of the long run, s (default: 600; --quick: 20)"
    )
    parser.add_argument("--seed", type=int, default=random.randrange(2**31))
    parser.add_argument("--quick", action="store_true", help="fewer cases, without monkeys")
    options = parser.parse_args()
    seconds = options.seconds or (QUICK_SECONDS if options.quick else 600.0)
    if seconds < 10.0:
        parser.error(f"--seconds: found {seconds:g}; expected at least 10, because of the pauses")
    from soak import RATE, soak

    OUT.mkdir(parents=True, exist_ok=True)
    begin = time.monotonic()
    profile = "quarter" if options.quick else "thorough"
    chosen = [target for target in FUZZED if target.in_quick or not options.quick]
    print(f"fuzzing, seed {options.seed} ...", flush=True)
    fuzzed = run_tests("fuzzing", chosen, options.seed, profile)
    print("faults ...", flush=True)
    faults = run_tests("faults", FAULTS, options.seed, profile)
    print(f"a run of {seconds:g} s ...", flush=True)
    rows = list(soak(seconds))
    problems = [f"{each.title}: {name}" for each in [*fuzzed, *faults] for name in each.failed]
    empty = [each.title for each in [*fuzzed, *faults] if not each.tests]
    problems += [f"{title}: no test was run" for title in empty]
    problems += problems_of(rows, int(RATE * seconds), judged=seconds >= 300.0)
    ages = sorted(row["p99"] for row in rows if row["p99"] is not None)
    about = (
        f"{datetime.now().astimezone():%Y-%m-%d %H:%M %Z} · {platform.system()} · "
        f"{os.cpu_count()} cores · Python {platform.python_version()} · "
        f"{'short form' if options.quick else 'long form'} · {time.monotonic() - begin:.0f} s"
    )
    summary = (
        f"A page with one client receives {RATE} packets/s for {seconds:g} s. It received "
        f"{rows[-1]['received']:,} of {int(RATE * seconds):,} packets and sent "
        f"{rows[-1]['states']:,} states. Memory was {rows[0]['memory']:.0f} MiB at the "
        f"beginning and {rows[-1]['memory']:.0f} MiB at the end, which is "
        f"{grown(rows, 'memory'):.2f} times the value after a quarter of the time, when history "
        "and caches are full. In the median second, 99 % of the states were sent within "
        f"{ages[len(ages) // 2]:.0f} ms after their packet. After a third of the time, the sender "
        "pauses for 2 s and then sends the delayed packets in a burst. After two thirds, the "
        "viewer process is suspended for 2 s."
    )
    page = _PAGE.format(
        about=html.escape(about),
        state="bad" if problems else "good",
        verdict=html.escape("; ".join(problems) or "All tests passed."),
        seed=options.seed,
        fuzzed=outcomes_table(fuzzed),
        faults=outcomes_table(faults),
        soak=html.escape(summary),
        picture=picture_of(rows),
        limits=table(["item", "maximum"], limits()),
    )
    (OUT / "index.html").write_text(page)
    if not options.quick:
        text = _DOCS.format(
            about=about,
            seed=options.seed,
            fuzzed=outcomes_markdown(fuzzed),
            faults=outcomes_markdown(faults),
            soak=summary,
            limits=markdown(["item", "maximum"], limits()),
        )
        (ROOT / "docs" / "attacks.md").write_text(text)
    print(f"written: {OUT / 'index.html'}")
    sys.exit("\n".join(problems) or 0)


if __name__ == "__main__":
    main()
