"""`compiled`: laws as machine code, made by numba, for runs that ask for it.

A law is a function of arrays, in the part of Python and numpy that numba knows. It runs in Python
as it stands; compiled, its calls of MuJoCo are calls in C, with addresses in place of model and
data (`address_of`). Both compute the same, to rounding.

numba keeps what it has compiled beside the module of the law, or in the user's cache folder, where
one of them can be written to (or where NUMBA_CACHE_DIR says).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from inspect import signature
from pathlib import Path
from typing import Any, TypeVar, cast

import mujoco
import numba
import numpy as np
from llvmlite import binding
from mujoco import (
    mj_comVel,
    mj_factorM,
    mj_fwdKinematics,
    mj_jacSite,
    mj_makeM,
    mj_rne,
    mj_solveM,
    mj_step,
    mj_step2,
    mju_cholFactor,
    mju_cholSolve,
    mju_mat2Quat,
    mju_mulQuat,
)
from numba import types
from numba.core import event
from numba.core.caching import FunctionCache
from numba.extending import intrinsic, overload, register_jitable

from ..frames import Ints

log = logging.getLogger(__name__)
F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")

_VOID, _INT, _NUMBER = types.void, types.int32, types.float64
_POINTER = types.intp  # an address


@cache
def compiled(law: F, *calls: Callable[..., Any]) -> F:
    """The law as machine code, which other threads may run beside.

    Args:
        law: takes addresses of MuJoCo's model and data, arrays and numbers.
        *calls: functions that it calls, innermost first. numba does not see when those of other
            modules change.
    """
    for function in calls:
        register_jitable(function)
    machine_code: Any = numba.njit(nogil=True, error_model="numpy")(law)
    with suppress(RuntimeError):  # no folder can be written to: then it is compiled every time
        machine_code._cache = _Files(law)
    return cast(F, machine_code)


def folder_of(machine_code: Any) -> Path | None:
    """Where a compiled law is kept for the next time; None where no folder can be written to."""
    found = machine_code.stats.cache_path
    return None if found is None else Path(found)


class _Files(FunctionCache):  # type: ignore[misc]
    """The files of a compiled law: damaged ones are made anew, and there may be no room for them.

    numba itself ends in both cases with what Python says of the file.
    """

    def load_overload(self, *of_law: Any) -> Any:
        try:
            return super().load_overload(*of_law)
        except Exception as error:  # anything may come from a file that is not whole
            log.warning("%s: what was compiled is damaged (%s)", self.cache_path, error)
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, *of_law: Any) -> None:
        try:
            super().save_overload(*of_law)
        except Exception as error:
            log.warning("%s: what was compiled cannot be kept (%s)", self.cache_path, error)


@contextmanager
def when_compiling(tell: Callable[[], None]) -> Iterator[None]:
    """Calls `tell` once if numba compiles something in its context, which takes many seconds."""

    class Listener(event.Listener):  # type: ignore[misc]
        told = False

        def on_start(self, event: Any) -> None:
            if not self.told:
                self.told = True
                tell()

        def on_end(self, event: Any) -> None:
            pass

    with event.install_listener("numba:compile", Listener()):
        yield


def table_of(*groups: tuple[Any, ...]) -> Ints:
    """What compiled code finds the values of tuples by, see `read`.

    Compiled code takes a table in no time, but to take a hundred arrays lets numba compile for a
    minute.

    Args:
        *groups: named tuples of arrays (of float64, without gaps), MuJoCo's models and data, and
            whole numbers; all have to outlive the table.

    Returns:
        (values, 3): address or number, rows and columns.
    """
    table: list[tuple[int, int, int]] = []
    for value in (value for group in groups for value in group):
        if isinstance(value, np.ndarray):
            if value.dtype != np.float64 or not value.flags.c_contiguous:
                raise ValueError(f"found {value.dtype} {value.strides}; expected float64, no gaps")
            columns = value.shape[1] if value.ndim > 1 else 1
            table.append((value.ctypes.data, len(value), columns))
        elif isinstance(value, mujoco.MjModel | mujoco.MjData):
            table.append((int(value._address), 0, 0))
        else:
            table.append((int(value), 0, 0))
    return np.array(table, np.int64)


def read(kind: type[T], table: Ints) -> T:
    """A named tuple from the front of its table, in compiled code.

    Args:
        kind: its class, whose annotations say which values are `Vector`, `Matrix` or bool; others
            are whole numbers.
        table: see `table_of`.
    """
    raise NotImplementedError


def address_of(owner: mujoco.MjModel | mujoco.MjData) -> int:
    """Where MuJoCo has a model or data, which have to outlive it."""
    return int(owner._address)


def _load_mujoco() -> None:
    """Lets compiled code find MuJoCo's functions by their names."""
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll"):
        for file in folder.glob(pattern):
            binding.load_library_permanently(str(file))
            return
    raise ImportError(f"found no library of MuJoCo in {folder}")


def _in_c(name: str, result: Any, *arguments: Any) -> Any:
    return types.ExternalFunction(name, result(*arguments))


_load_mujoco()
_step = _in_c("mj_step", _VOID, _POINTER, _POINTER)
_step2 = _in_c("mj_step2", _VOID, _POINTER, _POINTER)
_kinematics = _in_c("mj_fwdKinematics", _VOID, _POINTER, _POINTER)
_comVel = _in_c("mj_comVel", _VOID, _POINTER, _POINTER)
_makeM = _in_c("mj_makeM", _VOID, _POINTER, _POINTER)
_factorM = _in_c("mj_factorM", _VOID, _POINTER, _POINTER)
_solveM = _in_c("mj_solveM", _VOID, _POINTER, _POINTER, _POINTER, _POINTER, _INT)
_jacSite = _in_c("mj_jacSite", _VOID, _POINTER, _POINTER, _POINTER, _POINTER, _INT)
_rne = _in_c("mj_rne", _VOID, _POINTER, _POINTER, _INT, _POINTER)
_cholFactor = _in_c("mju_cholFactor", _INT, _POINTER, _INT, _NUMBER)
_cholSolve = _in_c("mju_cholSolve", _VOID, _POINTER, _POINTER, _POINTER, _INT)
_mat2Quat = _in_c("mju_mat2Quat", _VOID, _POINTER, _POINTER)
_mulQuat = _in_c("mju_mulQuat", _VOID, _POINTER, _POINTER, _POINTER)


# How calls of MuJoCo's Python functions are compiled: arrays, of float64 without gaps, become
# addresses. numba compiles these functions, and knows C's only where they are called.
# ruff: noqa: PLW0108
_COMPILED: dict[Callable[..., Any], Callable[..., Any]] = {
    mj_step: lambda model, data: _step(model, data),
    mj_step2: lambda model, data: _step2(model, data),
    mj_fwdKinematics: lambda model, data: _kinematics(model, data),
    mj_comVel: lambda model, data: _comVel(model, data),
    mj_makeM: lambda model, data: _makeM(model, data),
    mj_factorM: lambda model, data: _factorM(model, data),
    mj_solveM: lambda model, data, x, y: _solveM(model, data, x.ctypes.data, y.ctypes.data, len(y)),
    mj_jacSite: lambda model, data, linear, angular, site: _jacSite(
        model, data, linear.ctypes.data, angular.ctypes.data, site
    ),
    mj_rne: lambda model, data, accelerates, result: _rne(
        model, data, accelerates, result.ctypes.data
    ),
    mju_cholFactor: lambda matrix, least: _cholFactor(matrix.ctypes.data, len(matrix), least),
    mju_cholSolve: lambda x, factor, y: _cholSolve(
        x.ctypes.data, factor.ctypes.data, y.ctypes.data, len(y)
    ),
    mju_mat2Quat: lambda result, matrix: _mat2Quat(result.ctypes.data, matrix.ctypes.data),
    mju_mulQuat: lambda result, a, b: _mulQuat(result.ctypes.data, a.ctypes.data, b.ctypes.data),
}


@intrinsic  # type: ignore[untyped-decorator]
def _numbers_at(_: Any, address: Any) -> Any:
    """A pointer to numbers."""
    pointer = types.CPointer(types.float64)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(pointer))

    return pointer(address), generate


def _vector(table: Ints, k: int) -> Any:
    return numba.carray(_numbers_at(table[k, 0]), (table[k, 1],))


def _matrix(table: Ints, k: int) -> Any:
    return numba.carray(_numbers_at(table[k, 0]), (table[k, 1], table[k, 2]))


_READ = {
    "Vector": "_vector(table, {})",
    "Matrix": "_matrix(table, {})",
    "bool": "table[{}, 0] != 0",
}


@overload(read)  # type: ignore[untyped-decorator]
def _choose_read(kind: Any, table: Any) -> Any:
    made = kind.instance_class
    kinds = [getattr(each, "__forward_arg__", each) for each in made.__annotations__.values()]
    values = [_READ.get(each, "table[{}, 0]").format(k) for k, each in enumerate(kinds)]
    names = {"made": made, "_vector": register_jitable(_vector)}
    names["_matrix"] = register_jitable(_matrix)
    exec(f"def read_it(kind, table): return made({', '.join(values)})", names)  # as namedtuple does
    reading = names["read_it"]
    reading.__signature__ = signature(_choose_read)
    return reading


def _compile_calls(function: Callable[..., Any], implementation: Callable[..., Any]) -> None:
    def choose(*_: Any) -> Callable[..., Any]:
        return implementation

    choose.__signature__ = signature(implementation)  # type: ignore[attr-defined]
    overload(function)(choose)


for _function, _implementation in _COMPILED.items():
    _compile_calls(_function, _implementation)
