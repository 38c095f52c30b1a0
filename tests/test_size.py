"""Limits on the size of classes and folders, and on imports of private modules."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

from syntax import nodes_of

import sero_mj

PACKAGE = Path(sero_mj.__file__).parent
MAX_METHODS = 35
MAX_FILES = 25
# Lines of Python; lower these limits as the code shrinks.
MAX_LINES_OF_CORE = 75_600
MAX_LINES = 107_500


def modules() -> dict[Path, str]:
    return {path: path.read_text("utf-8") for path in sorted(PACKAGE.rglob("*.py"))}


def test_classes_have_few_methods() -> None:
    too_large = {
        f"{path.relative_to(PACKAGE)}: {node.name}": count
        for path, source in modules().items()
        for node in nodes_of(source)
        if isinstance(node, ast.ClassDef)
        and (count := sum(isinstance(each, ast.FunctionDef) for each in node.body)) > MAX_METHODS
    }
    assert not too_large


def test_folders_have_few_files() -> None:
    files = Counter(path.parent for path in modules() if path.name != "__init__.py")
    assert not {folder: count for folder, count in files.items() if count > MAX_FILES}


def test_private_modules_are_imported_in_their_folder_only() -> None:
    private = {
        path.stem: path.parent
        for path in modules()
        if path.stem.startswith("_") and not path.stem.startswith("__")
    }
    for path, source in modules().items():
        for node in nodes_of(source):
            if isinstance(node, ast.ImportFrom):
                for name in [*(node.module or "").split("."), *(each.name for each in node.names)]:
                    assert private.get(name, path.parent) == path.parent, f"{path}: {name}"


def test_package_does_not_grow() -> None:
    lines = {path: source.count("\n") for path, source in modules().items()}
    core = sum(n for path, n in lines.items() if PACKAGE / "extensions" not in path.parents)
    assert core <= MAX_LINES_OF_CORE
    assert sum(lines.values()) <= MAX_LINES
