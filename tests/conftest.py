"""Chooses the OpenGL backend before anything imports mujoco, and contains shared fixtures.

`--no-skips` (in `.ci/run`) fails a test that is skipped because a tool is missing.
`--hypothesis-profile=thorough` (in `make thorough`) runs all examples of property tests instead of
a quarter, all cases of slow tests instead of the first and the last one, and the tests marked
`thorough`, which otherwise run only if they are named. Tests marked `realtime` run alone: parallel
runs omit them, and others run them last.
"""

from __future__ import annotations

from sero_mj.viewer.image.backend import choose_backend

choose_backend()

import contextlib
import ctypes
import gc
import importlib.util
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from xdist.scheduler import LoadScopeScheduling

from sero_mj.base.errors import DeclarationError
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.study.engine import available_cpus

# Background jobs of a shell and nohup ignore SIGINT, which programs started by tests would inherit.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# There are no deadlines, because the duration of an example depends on other load of the machine.
for name, examples in {"quarter": 25, "thorough": 100}.items():
    settings.register_profile(name, max_examples=examples, deadline=None)
settings.load_profile("quarter")

# Packages that a machine cannot have: dm-control from Python 3.13 on, and those of other systems.
_MAY_BE_SKIPPED = (
    "dm-control is not installed", "by hand", "Linux", "no IPv6 groups",
    "stable-baselines3", "octave-cli", "rustc", "ur_rtde is not installed",
    "rclpy cannot be installed", "a sleep of 1 ms takes",
)  # fmt: skip
# Browsers and windows use both cores; one worker runs all pages, and one all windows. Start pages
# of both listen on the same ports.
_PAGES = ("test_web", "test_viewer", "test_notebook", "test_window_start")
_WINDOWS = ("test_window", "test_overlay_window", "test_steering_window")
_SCREENS = (*_PAGES, *_WINDOWS)
_LIVE = (*_SCREENS, "test_docs")
# These tests simulate whole runs or start many processes, and take half of the time of logic tests.
_SLOW = (
    "test_bags", "test_biped", "test_calibrate", "test_camera_motion", "test_cartesian_control",
    "test_compiler", "test_composition", "test_connecting", "test_dlr_models", "test_doors",
    "test_environment", "test_explain", "test_external_control", "test_fmu", "test_foxglove",
    "test_framing", "test_franka_robot", "test_free_base", "test_fri_robot", "test_gallery",
    "test_gymnasium", "test_hit_hand", "test_hostile", "test_identify", "test_iiwa_robot",
    "test_import_robot", "test_inverse_kinematics", "test_justin", "test_link_transforms",
    "test_live_control", "test_many_environments", "test_mutations", "test_new_files",
    "test_parallel_robots", "test_passes", "test_player", "test_plot", "test_pulling",
    "test_recorder", "test_robot_places", "test_ros2", "test_rtde_robot", "test_run_batch",
    "test_run_recording", "test_scenarios", "test_shm", "test_signs", "test_simulate_command",
    "test_snippet", "test_stable_baselines", "test_torque_loop", "test_trees", "test_trigger",
    "test_zenoh",
)  # fmt: skip
# These tests open the ports of included scenes, so one worker runs them all.
_PORTS = (
    "test_cli", "test_docs", "test_fri", "test_mirror", "test_packet_buffer", "test_shm",
    "test_simulate_command", "test_torque_plots", "test_udp", "test_video",
    "test_without_display",
)  # fmt: skip

# These tests parse all files of the project, so one worker runs them.
_SYNTAX = ("test_layers", "test_size")

# Processes that pytest and multiprocessing need until the end, by parts of command lines.
_OWN_CHILDREN = (b"multiprocessing.resource_tracker", b"multiprocessing.forkserver", b"playwright")
_MARK = "SERO_MJ_TEST"  # in the environment of processes started by a test

ROOT = Path(__file__).resolve().parent.parent


def examples(thorough: int) -> int:
    """Returns the number of examples of a property test from the number in a thorough run."""
    return max(thorough * settings().max_examples // 100, 5)


def sampled(cases: Iterable[Any], kept: int) -> list[Any]:
    """Returns the cases of a test, of which all but the first only run in thorough runs.

    A case is a list if a test has several arguments.
    """
    return [
        pytest.param(
            *(case if isinstance(case, list) else [case]),
            marks=[pytest.mark.thorough] if k >= kept else [],
        )
        for k, case in enumerate(cases)
    ]


def free_udp_port() -> int:
    """Returns a port on which nothing listens."""
    with socket.socket(type=socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])


def import_script(path: Path) -> ModuleType:
    """Imports a script that is in no package as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # dataclasses look up their module
    spec.loader.exec_module(module)
    return module


@contextlib.contextmanager
def raises_with(error: type[Exception] = DeclarationError, /, **values: object) -> Iterator[None]:
    """Expects an error with these attributes, or with a single problem that has them."""
    with pytest.raises(error) as caught:
        yield
    told = caught.value
    (problem,) = getattr(told, "problems", [getattr(told, "problem", told)])
    found = {name: getattr(told if hasattr(told, name) else problem, name) for name in values}
    assert {name: _plain(value) for name, value in found.items()} == {
        name: _plain(value) for name, value in values.items()
    }


def _plain(value: Any) -> object:
    """Converts an array to a list, and NaN, which does not equal itself, to a string."""
    value = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
    return "NaN" if isinstance(value, float) and math.isnan(value) else value


def problems_in(scene: Path) -> list[str]:
    """Returns line, key and message of every problem in a scene file."""
    with pytest.raises(DeclarationError) as caught:
        load_scene(scene)
    return [f"{p.line}: {p.key}: {p.message}" for p in caught.value.problems]


@pytest.fixture(scope="session", autouse=True)
def state_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A state folder for tests, so that the user's views are neither shown nor changed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture
def controller() -> Iterator[socket.socket]:
    """The socket of a robot controller."""
    with socket.socket(type=socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(5.0)
        yield sock


@pytest.fixture(autouse=True)
def backend() -> Iterator[None]:
    """Commands run in this process choose the window's OpenGL; later programs do not."""
    before = os.environ.get("MUJOCO_GL")
    yield
    if before is not None:
        os.environ["MUJOCO_GL"] = before


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--no-skips", action="store_true", help="a skipped test has failed")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Skips files without tests for `make quick` and `make core`, without importing them."""
    left_out = (*_SLOW, *_LIVE) if "not slow and not live" in config.option.markexpr else ()
    return True if collection_path.name.startswith(left_out) else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if settings().max_examples < settings.get_profile("thorough").max_examples and not any(
        "::" in name for name in config.args
    ):
        left_out = [item for item in items if item.get_closest_marker("thorough")]
        left_out += _inner_cases(items)
        config.hook.pytest_deselected(items=left_out)
        skipped = {*left_out}
        items[:] = [item for item in items if item not in skipped]
    for item in items:
        if item.path.name.startswith(_LIVE):
            item.add_marker(pytest.mark.live)
        if item.path.name.startswith(_SLOW):
            item.add_marker(pytest.mark.slow)
    alone = {item for item in items if item.get_closest_marker("realtime")}
    if hasattr(config, "workerinput"):
        config.hook.pytest_deselected(items=[*alone])
        items[:] = [item for item in items if item not in alone]
    # Longest first, while browsers are busy.
    items.sort(key=lambda item: (item in alone, not item.path.name.startswith("test_docs")))


def _inner_cases(items: list[pytest.Item]) -> list[pytest.Item]:
    """Returns the cases of slow tests for thorough runs: all but the first and the last one."""
    cases: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.path.name.startswith((*_SLOW, *_LIVE)):
            cases.setdefault(item.nodeid.partition("[")[0], []).append(item)
    return [item for each in cases.values() for item in each[1:-1]]


def pytest_collection_finish() -> None:
    # Modules and thousands of tests persist, so each garbage collection would take 0.15 s.
    gc.collect()
    gc.freeze()


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("realtime") and (took := _sleep_of_1_ms()) > 1.5e-3:
        pytest.skip(f"a sleep of 1 ms takes {1e3 * took:.1f} ms on this machine (1 of 20 sleeps)")


def _sleep_of_1_ms() -> float:
    """Returns the duration in seconds that 19 of 20 sleeps of 1 ms do not exceed."""
    took = []
    for _ in range(200):
        begin = time.perf_counter()
        time.sleep(1e-3)
        took.append(time.perf_counter() - begin)
    return sorted(took)[190]


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol() -> Iterator[None]:
    yield
    _give_memory_back()


_starts = 0  # processes started here


def _count_start(event: str, _: object) -> None:
    global _starts  # noqa: PLW0603
    if event in ("subprocess.Popen", "os.fork", "os.posix_spawn"):
        _starts += 1


if sys.platform == "linux":
    sys.addaudithook(_count_start)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_call() -> Iterator[None]:
    """Ends processes that a test has left running, even if the test fails."""
    before, mark = _starts, f"{os.getpid()}-{time.monotonic_ns()}"
    os.environ[_MARK] = mark
    yield
    os.environ.pop(_MARK, None)
    if _starts > before:
        _end_processes(f"{_MARK}={mark}".encode())


def _end_processes(variable: bytes) -> None:
    """Ends the processes that have a variable in their environment."""
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            command = (process / "cmdline").read_bytes()
            is_own = any(name in command for name in _OWN_CHILDREN)
            if not is_own and variable in (process / "environ").read_bytes().split(b"\0"):
                os.kill(int(process.name), signal.SIGKILL)


_after_giving_back = 0.0  # MB in use


def _give_memory_back() -> None:
    """Returns the freed memory of worlds and images to the system if much memory was used.

    Otherwise, the C library holds 3 GB after all tests, of which 0.4 GB are in use.
    """
    global _after_giving_back  # noqa: PLW0603
    if sys.platform == "linux" and _used_memory() > _after_giving_back + 200.0:
        ctypes.CDLL(None).malloc_trim(0)
        _after_giving_back = _used_memory()


def _used_memory() -> float:
    """Returns the memory in use by this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 1e6


class _GroupsByFile(LoadScopeScheduling):
    # Marks `xdist_group` are not used, because pytest 9.2 ignores them (pytest-xdist issue 1386).
    def _split_scope(self, nodeid: str) -> str:
        name = nodeid.partition("::")[0].rpartition("/")[2]
        if name.startswith(_SCREENS):
            return "pages" if name.startswith(_PAGES) else "windows"
        if name.startswith(_SYNTAX):
            return "syntax"
        # Larger scopes come first, then single tests in their order.
        return "ports" if name.startswith(_PORTS) else nodeid


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    # Tests wait for browsers and windows, so both cores would be idle for a quarter of the time.
    is_all = not config.option.markexpr
    return available_cpus() + is_all


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> LoadScopeScheduling:
    return _GroupsByFile(config, log)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    outcome: Any = yield
    report = outcome.get_result()
    if report.skipped and item.config.getoption("--no-skips"):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
        if not any(allowed in str(reason) for allowed in _MAY_BE_SKIPPED):
            report.outcome = "failed"
            report.longrepr = f"{item.nodeid} was skipped, and may not be here: {reason}"


@pytest.fixture(scope="session")
def lwr() -> SerialRobot:
    return SerialRobot.from_model("lwr")


@pytest.fixture(scope="session")
def lwr_world(lwr: SerialRobot) -> World:
    """A world with the LWR and without a floor; tests create their own data."""
    return World(Scene(robots=[lwr], floor=False))


@pytest.fixture(scope="session")
def node_modules() -> Path:
    """The packages that check and bundle the player's JavaScript."""
    if shutil.which("npm") is None:
        pytest.skip("npm is not installed")
    subprocess.run([ROOT / ".ci" / "js", "install"], check=True)
    return ROOT / ".venv" / "js" / "node_modules"


@pytest.fixture(scope="session")
def playwright() -> Iterator[Any]:
    """Playwright, which can exist once per process."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        yield playwright


@pytest.fixture(scope="session")
def browser(playwright: Any) -> Iterator[Any]:
    """Chromium, controlled by Playwright."""
    yield from _chromium(playwright)


@pytest.fixture
def own_browser(playwright: Any) -> Iterator[Any]:
    """Another browser, for tests that may leave it unusable for others."""
    yield from _chromium(playwright)


def _chromium(playwright: Any) -> Iterator[Any]:
    from web_tools import ARGUMENTS, CHROMIUM

    browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
    yield browser
    browser.close()


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """An empty home folder."""
    monkeypatch.setenv("HOME", str(tmp_path))
    yield
