"""Definitions, imports and calls in Python sources, parsed once for all tests."""

from __future__ import annotations

import ast
from functools import cache


@cache
def nodes_of(source: str) -> tuple[ast.AST, ...]:
    """Returns classes, imports and calls in the order of `ast.walk`."""
    kinds = (ast.ClassDef, ast.Import, ast.ImportFrom, ast.Call)
    return tuple(node for node in ast.walk(ast.parse(source)) if isinstance(node, kinds))
