"""Layers: which folders may import which, and what `import sero_mj` loads."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest
from syntax import nodes_of

import sero_mj

PACKAGE = Path(sero_mj.__file__).parent
EXTENSIONS = tuple(sorted(file.parent.name for file in PACKAGE.glob("extensions/*/__init__.py")))
# The folders of the README, top to bottom, and `load.py`. The package itself is above all.
ORDER = (
    "",
    "base",
    "robots.kinematics",
    "robots.importers",
    "robots.declared",
    "robots.assemble",
    "robots.external",
    "data.receive",
    "data.record",
    "data.drive",
    "data.send",
    "simulate.control",
    "simulate.runs",
    "simulate.external_control",
    "simulate",
    "load",
    "viewer.decor",
    "viewer.image",
    "viewer.session",
    "viewer.player",
    "viewer.panels",
    "viewer.tools",
    "viewer.host",
    "viewer.web",
    "viewer.window",
    "viewer.program",
    "simulate.tools",
    "study",
    "cli",
    "__main__",
    *(f"extensions.{name}" for name in EXTENSIONS),
    "extensions",
)
# Extensions that import others. Code that two extensions need is in the core.
BETWEEN: dict[str, tuple[str, ...]] = {}
FOLDERS = [folder for folder in ORDER if folder not in ("", "load", "__main__")]
PARENTS = ("robots", "data", "viewer")  # folders without files
# Modules that the independent check and the packet layer must not import.
NO_MUJOCO = (
    *("extensions.x3d.reader", "extensions.x3d.wrl", "robots.kinematics.dh", "base.frames"),
    *("robots.declared.shapes", "data.receive", "data.record.replay"),
)
MUJOCO = ("mujoco", "dm_control")
HOMES: dict[str, str] = sero_mj._HOME


def read_package(folder: Path = PACKAGE) -> dict[str, str]:
    """Returns source by module name below `sero_mj`; a package has its folder's name."""
    sources = {}
    for file in sorted(folder.rglob("*.py")):
        if file.parent.name == "snippets":  # for user programs
            continue
        parts = list(file.relative_to(folder).with_suffix("").parts)
        if parts[-1] == "__init__":
            parts.pop()
        sources[".".join(parts)] = file.read_text(encoding="utf-8")
    return sources


@cache
def imported_names(module: str, source: str, *, is_package: bool) -> list[tuple[int, str]]:
    """Returns line and dotted name of every import in a module; `?` for a computed name."""
    found: list[tuple[int, str]] = []
    for node in nodes_of(source):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = [node.module] if node.module else []
            if node.level:
                here = ["sero_mj", *filter(None, module.split("."))]
                base = here[: len(here) - node.level + is_package] + base
            found += [(node.lineno, ".".join([*base, alias.name])) for alias in node.names]
        elif isinstance(node, ast.Call):
            called = ast.unparse(node.func).rpartition(".")[2]
            if called in ("import_module", "__import__"):
                found.append((node.lineno, "?"))
    return found


@cache
def packages(modules: tuple[str, ...]) -> set[str]:
    """Returns the modules that contain others."""
    return {""} | {outer for module in modules if (outer := module.rpartition(".")[0])}


def imports_of(module: str, modules: dict[str, str]) -> list[tuple[int, str]]:
    """Returns line and module of every import: ours as `.name`, others by full name."""
    return resolved(module, modules[module], tuple(modules))


@cache
def resolved(module: str, source: str, modules: tuple[str, ...]) -> list[tuple[int, str]]:
    is_package = module in packages(modules)
    found: list[tuple[int, str]] = []
    for line, full in imported_names(module, source, is_package=is_package):
        name = full
        if full in ("sero_mj", "sero_mj.*"):
            name = "?"  # any public name may be imported from it
        elif full.startswith("sero_mj."):
            name = full.removeprefix("sero_mj.")
            name = HOMES.get(name, name)  # the module that defines the public name
            while name and name not in modules:
                name = name.rpartition(".")[0]  # an attribute of a module
            name = f".{name}"
        found.append((line, name))
    return found


@cache
def folder_of(module: str) -> str:
    """Returns the innermost folder of `ORDER` that contains a module."""
    parts = module.split(".")
    folders = [".".join(parts[:count]) for count in range(len(parts), 0, -1)]
    return next((folder for folder in folders if folder in ORDER), "")


def rank(module: str) -> int:
    return ORDER.index(folder_of(module))


def violations(modules: dict[str, str]) -> list[str]:
    """Returns imports against the direction, cycles, and hidden imports."""
    wrong: list[str] = []
    graph: dict[str, set[str]] = {}
    for module in modules:
        graph[module] = set()
        if not module:
            continue  # it exports lazily, which another test checks
        for line, name in imports_of(module, modules):
            target = name.removeprefix(".")
            if name == "?":
                wrong.append(f"{module}:{line} hides what it imports")
            elif name.startswith("."):
                if target:
                    graph[module].add(target)
                beside = folder_of(target) == folder_of(module)
                internal = "._" in f".{target}"  # of another folder
                if (rank(target) >= rank(module) or internal) and not beside:
                    wrong.append(f"{module}:{line} imports {target}")
                elif is_other_extension(module, target):
                    wrong.append(f"{module}:{line} imports the extension {target}")
    return wrong + [f"circle: {' > '.join(circle)}" for circle in circles(graph)]


def is_other_extension(module: str, target: str) -> bool:
    """Returns whether a module imports an extension it does not belong to."""
    parent, own, to = "extensions", folder_of(module), folder_of(target)
    if not to.startswith(f"{parent}.") or own == to:
        return False
    return to.removeprefix(f"{parent}.") not in BETWEEN.get(own.removeprefix(f"{parent}."), ())


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Returns one path for each import cycle that a depth-first search finds."""
    found: list[list[str]] = []
    done: set[str] = set()

    def visit(module: str, path: list[str]) -> None:
        if module in path:
            found.append([*path[path.index(module) :], module])
        elif module not in done:
            for target in sorted(graph.get(module, ())):
                visit(target, [*path, module])
            done.add(module)

    for module in sorted(graph):
        visit(module, [])
    return found


def reachable(start: str, modules: dict[str, str]) -> dict[str, list[str]]:
    """Returns the modules that an import of `start` may load, and their third-party imports."""
    todo, seen = [start], {}
    while todo:
        module = todo.pop()
        if module in seen or not module:
            continue
        names = [name for _, name in imports_of(module, modules)]
        todo += [name[1:] for name in names if name.startswith(".")]
        seen[module] = [name.split(".")[0] for name in names if not name.startswith(".")]
    return seen


def test_every_file_is_in_a_folder_of_the_design() -> None:
    nowhere = {module for module in read_package() if not folder_of(module)}
    assert nowhere == {"", *PARENTS}


def test_every_import_goes_up_or_sideways_without_cycles() -> None:
    modules = read_package()
    assert violations(modules) == []
    # The files were really read: there are at least this many imports of our modules.
    found = [name for module in modules for _, name in imports_of(module, modules)]
    assert sum(name.startswith(".") for name in found) > 100


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "line", "found"),
    [
        ("robots.kinematics.dh", "from ...data.receive.mailbox import age", "imports data.receive"),
        ("robots.kinematics.dh", "from ...data.receive import source", "imports data.receive"),
        ("robots.kinematics.dh", "from ...data import receive", "imports data.receive"),
        ("robots.kinematics.dh", "import sero_mj.data.receive.udp", "imports data.receive.udp"),
        ("robots.kinematics.dh", "from sero_mj.data.drive.wiring import wire", "data.drive.wiring"),
        ("robots.kinematics.dh", "from sero_mj import Mirror", "imports data.drive.mirror"),
        ("robots.kinematics.dh", "from ... import HeadlessRenderer", "imports viewer.image"),
        ("data.receive.source", "from ..drive.place import follow", "imports data.drive.place"),
        (
            "viewer.program.process",
            "from ...robots.external._model_robot import TOGGLES",
            "imports robots.external._model_robot",
        ),
        (
            "data.drive.place",
            "from ...viewer.decor.geom_buffer import GeomBuffer",
            "imports viewer.decor.geom_buffer",
        ),
        (
            "data.drive.place",
            "if TYPE_CHECKING:\n    from ...viewer.decor import geom_buffer",
            "decor.geom_buffer",
        ),
        (
            "data.drive.place",
            "def f():\n    from ...viewer.image import camera",
            "imports viewer.image.camera",
        ),
        (
            "viewer.decor.geom_buffer",
            "from ..image.camera import find_camera",
            "imports viewer.image.camera",
        ),
        ("viewer.image.camera", "from ...cli import main", "imports cli"),
        ("viewer.session.clock", "from ..window.host import Window", "imports viewer.window"),
        ("study.figure", "from ..extensions.fmu import fmu", "imports extensions.fmu"),
        ("cli.view", "from ..extensions.photo import over", "imports extensions.photo"),
        ("extensions.rtde.robot", "from ..fmu import fmu", "imports the extension extensions.fmu"),
        ("base.errors", "from ..robots.kinematics import dh", "imports robots.kinematics.dh"),
        ("base.paths", "def f():\n    from ..cli import main", "imports cli"),
        ("robots.assemble", "from ...viewer import decor", "imports viewer.decor"),
        ("cli.plot", "from ..__main__ import main", "imports __main__"),
        (
            "robots.declared.limbs",
            "from .scene import Scene",
            "robots.declared.limbs > robots.declared.scene > ",
        ),
        ("base.errors", "from . import paths", "circle: base.errors > base.paths > base.errors"),
        ("data.drive.place", "from . import place", "circle: data.drive.place > data.drive.place"),
        (
            "data.drive.place",
            "import_module('sero_mj.viewer.decor.geom_buffer')",
            "hides what it imports",
        ),
        ("data.drive.place", "importlib.import_module(name)", "hides what it imports"),
        ("data.drive.place", "import sero_mj", "hides what it imports"),
        (
            "data.drive.place",
            "__import__('sero_mj.viewer.decor.geom_buffer')",
            "hides what it imports",
        ),
    ],
)
def test_rule_detects_violations(module: str, line: str, found: str) -> None:
    modules = read_package()
    modules[module] += f"\n{line}\n"
    assert any(found in wrong for wrong in violations(modules)), violations(modules)


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("data.drive.place", "from ...robots.assemble.world import World"),
        ("data.drive.place", "from ..receive import source"),
        ("data.drive.place", "from ... import __version__"),
        ("data.drive.place", "from ...base import paths"),
        ("data.drive.place", "from ... import SerialRobot"),
        ("cli.plot", "from .arguments import port"),
        ("__main__", "import sero_mj.viewer.image.backend"),
        ("base.errors", "import mujoco.viewer, decor"),  # a third-party decor feature
    ],
)
def test_rule_allows_valid_imports(module: str, line: str) -> None:
    modules = read_package()
    modules[module] += f"\n{line}\n"
    assert violations(modules) == []


@pytest.mark.parametrize("name", NO_MUJOCO)
def test_mujoco_checks_and_packet_readers_do_not_import_mujoco(name: str) -> None:
    modules = read_package()
    for start in [module for module in modules if f"{module}.".startswith(f"{name}.")]:
        for module, others in reachable(start, modules).items():
            assert not set(others) & set(MUJOCO), f"{start} imports MuJoCo through {module}"


def test_mujoco_imports_are_detected_anywhere() -> None:
    modules = read_package()
    for module, line in (
        ("base.frames", "def f():\n    import mujoco.viewer"),
        ("base.errors", "from dm_control.mjcf import RootElement"),
    ):
        found = reachable("data.receive.udp", {**modules, module: f"{modules[module]}\n{line}\n"})
        assert set(found[module]) & set(MUJOCO)
        assert "structure" in " ".join(found)


def loaded_after(*modules: str) -> set[str]:
    """Returns top-level packages that a fresh interpreter has loaded after importing these."""
    code = f"import sys; sys.path.insert(0, {str(PACKAGE.parent)!r})\n"
    code += "".join(f"import {module}\n" for module in modules)
    code += "print(*{name.split('.')[0] for name in sys.modules})"
    done = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=60
    )
    return set(done.stdout.split())


def test_importing_the_package_imports_neither_numpy_nor_mujoco() -> None:
    loaded = loaded_after("sero_mj")
    assert "sero_mj" in loaded
    assert not loaded & {"numpy", "pydantic", *MUJOCO}


@pytest.mark.extensions
def test_reading_packets_and_checking_kinematics_load_no_mujoco() -> None:
    names = [m for m in read_package() if any(f"{m}.".startswith(f"{n}.") for n in NO_MUJOCO)]
    assert "data.receive.udp" in names
    loaded = loaded_after(*(f"sero_mj.{name}" for name in names))
    assert "numpy" in loaded
    assert not loaded & set(MUJOCO)


def test_lazy_names_equal_those_seen_by_type_checkers() -> None:
    tree = ast.parse((PACKAGE / "__init__.py").read_text(encoding="utf-8"))
    (guarded,) = [
        node
        for node in tree.body
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    ]
    seen = {}
    for node in guarded.body:
        assert isinstance(node, ast.ImportFrom)
        for alias in node.names:
            assert alias.asname == alias.name  # otherwise mypy does not see an export
            assert alias.name not in seen
            seen[alias.name] = node.module
    assert seen == HOMES


@pytest.mark.parametrize("name", sorted(HOMES))
def test_lazy_name_is_the_object_in_its_module(name: str) -> None:
    home = import_module(f"sero_mj.{HOMES[name]}")
    assert getattr(sero_mj, name) is getattr(home, name)
    assert getattr(home, name).__module__ == home.__name__
    assert name in dir(sero_mj)


def test_missing_name_raises_attribute_error() -> None:
    with pytest.raises(AttributeError, match=r"^module 'sero_mj' has no attribute 'Miror'$"):
        sero_mj.Miror  # noqa: B018


def test_viewer_does_not_import_simulate_and_simulate_imports_viewer_in_tools_only() -> None:
    modules = read_package()
    found = []
    for module in modules:
        parent = module.partition(".")[0]
        apart = {"viewer": ".simulate", "simulate": ".viewer"}.get(parent)
        if apart is None or module.startswith("simulate.tools"):
            continue
        found += [
            f"{module}:{line} imports {name}"
            for line, name in imports_of(module, modules)
            if name.startswith(apart)
        ]
    assert found == []


def test_readme_map_lists_folders_in_import_order() -> None:
    text = (PACKAGE.parent / "README.md").read_text(encoding="utf-8")
    mapped = re.findall(r"^\| `([\w/]+)` \| ", text.partition("## Packages")[2], re.MULTILINE)
    folders = [folder for folder in FOLDERS if not folder.startswith("extensions.")]
    assert mapped == [folder.replace(".", "/") for folder in folders]
    tops = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert {name.partition("/")[0] for name in mapped} == tops


@pytest.mark.parametrize(
    "folder", [*PARENTS, *(name for name in FOLDERS if name not in ("cli", "extensions"))]
)
def test_each_folder_documents_input_output_and_first_file(folder: str) -> None:
    folder = folder.replace(".", "/")
    source = (PACKAGE / folder / "__init__.py").read_text(encoding="utf-8")
    about = ast.get_docstring(ast.parse(source)) or ""
    assert "\nIn: " in about and "Out: " in about and "\nOpen first: " in about
    for file in re.findall(r"`([\w/]+\.py)`", about):
        assert (PACKAGE / folder / file).is_file(), file
