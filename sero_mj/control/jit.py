"""`compiled`: laws as machine code, made by numba, for runs that ask for it.

A law is a function of arrays, in the part of Python and numpy that numba knows. It runs in Python
as it stands; compiled, its calls of MuJoCo are calls in C, with addresses in place of model and
data (`address_of`). Both compute the same, to rounding.

numba keeps what it has compiled beside the module of the law, or in the user's cache folder.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from inspect import signature
from pathlib import Path
from typing import Any, TypeVar

import mujoco
import numba
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
from numba.extending import overload, register_jitable

F = TypeVar("F", bound=Callable[..., Any])

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
    machine_code: F = numba.njit(cache=True, nogil=True, error_model="numpy")(law)
    return machine_code


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


def _compile_calls(function: Callable[..., Any], implementation: Callable[..., Any]) -> None:
    def choose(*_: Any) -> Callable[..., Any]:
        return implementation

    choose.__signature__ = signature(implementation)  # type: ignore[attr-defined]
    overload(function)(choose)


for _function, _implementation in _COMPILED.items():
    _compile_calls(_function, _implementation)
