"""`ConstraintArrays`: constraints of a `MjData` in place, where Python's bindings give copies."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.introspect.ast_nodes import ArrayType, PointerType
from mujoco.introspect.structs import STRUCTS

from ..frames import Array, Ints

_C_TYPES = {
    "int": ctypes.c_int,
    "mjtBool": ctypes.c_bool,
    "mjtByte": ctypes.c_ubyte,
    "mjtNum": ctypes.c_double,
    "mjtSize": ctypes.c_int64,
    "size_t": ctypes.c_size_t,
    "uintptr_t": ctypes.c_size_t,
    "uint64_t": ctypes.c_uint64,
}


class ConstraintArrays(NamedTuple):
    """Views of numbers in a `MjData`, which has to outlive them.

    Attributes:
        counts: (5,), of contacts, and of constraints: equality, friction, limits, all.
        force_pointer: (1,), where `efc_force` is.
        arena: (numbers,), in which it is.
        arena_address: where the arena is.
    """

    counts: Ints
    force_pointer: Ints
    arena: Array
    arena_address: int

    @classmethod
    def of(cls, data: mujoco.MjData) -> ConstraintArrays:
        """Finds them by MuJoCo's own description of its structures."""
        address, offsets = int(data._address), _offsets()
        counts = np.ctypeslib.as_array((ctypes.c_int32 * 5).from_address(address + offsets["ncon"]))
        force = (ctypes.c_int64 * 1).from_address(address + offsets["efc_force"])
        arena = ctypes.c_int64.from_address(address + offsets["arena"]).value
        size = ctypes.c_int64.from_address(address + offsets["narena"]).value
        numbers = (ctypes.c_double * (size // 8)).from_address(arena)
        as_array = np.ctypeslib.as_array
        return cls(counts, as_array(force), as_array(numbers), arena)


@cache
def _offsets() -> dict[str, int]:
    """Where the fields of `MjData` are in it, bytes."""
    layout = _as_ctypes("mjData")
    return {name: getattr(layout, name).offset for name, *_ in layout._fields_}


def _as_ctypes(struct: str) -> type[ctypes.Structure]:
    """A structure of MuJoCo with the layout that a C compiler gives it."""
    fields: list[tuple[str, Any]] = []
    for field in STRUCTS[struct].fields:
        kind = field.type
        if isinstance(kind, PointerType):
            fields.append((field.name, ctypes.c_void_p))
            continue
        extents = kind.extents if isinstance(kind, ArrayType) else ()
        name = (kind.inner_type if isinstance(kind, ArrayType) else kind).name
        c_type = _C_TYPES[name] if name in _C_TYPES else _as_ctypes(name.removesuffix("_"))
        for extent in reversed(extents):
            c_type = c_type * extent
        fields.append((field.name, c_type))
    return type(struct, (ctypes.Structure,), {"_fields_": fields})
