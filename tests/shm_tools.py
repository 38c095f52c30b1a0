"""Blocks of shared memory for tests, and writers in C."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from sero_mj.data.receive.shm_block import Block

needs_posix = pytest.mark.skipif(
    sys.platform == "win32", reason="Windows has no POSIX shared memory"
)


@pytest.fixture
def block(request: pytest.FixtureRequest) -> Iterator[str]:
    """Yields an unused block name; the test must not leave a block."""
    name = f"/sero_test_{os.getpid()}_{abs(hash(request.node.nodeid)) % 10**6}"
    yield name
    try:
        left = Block(name)
    except OSError:
        return
    left.unlink()
    left.close()
    pytest.fail(f"{name} is left in shared memory")


def make(name: str, content: bytes = b"") -> Block:
    """Creates a block with this content."""
    made = Block(name, writable=True, create=True)
    made.resize(len(content))
    made.write(content)
    return made


def remove(block: Block) -> None:
    block.unlink()
    block.close()


def unlink(name: str) -> None:
    """Removes a block that a killed writer has left."""
    remove(Block(name))


def compile_c(source: Path, folder: Path) -> Path:
    """Compiles a C program; warnings are errors."""
    compiler = shutil.which("cc")
    if compiler is None:
        if shutil.which("apt-get"):
            pytest.fail("no C compiler; .ci/setup installs it")
        pytest.skip("no C compiler on this machine")
    program = folder / source.stem
    flags = ["-std=c11", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    libraries = ["-lm"] if sys.platform == "darwin" else ["-lrt", "-lm"]
    command = [compiler, *flags, "-o", str(program), str(source), *libraries]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return program
