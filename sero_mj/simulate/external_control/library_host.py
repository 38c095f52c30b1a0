"""Loads a library and calls its function. It also runs as the process of an isolated library.

The process imports only this file, so it starts quickly. It answers with one byte: `READY` once the
library is loaded, then `DONE` after each call.
"""

import ctypes
from typing import Any

# Arrays of n values in the order of the structure.
ARRAYS = (
    "angles",
    "velocities",
    "torques",
    "target_angles",
    "target_velocities",
    "target_accelerations",
    "gravity",
    "torques_out",
)
HEAD = 8  # size of the time, which precedes the arrays in shared memory, bytes
READY, DONE = b"r", b"1"
NOT_LOADED, NO_FUNCTION = b"l", b"f"  # the reason is printed to stderr


class RobotStruct(ctypes.Structure):
    """The structure `sero_mj_robot` of sero_mj_controller.h."""

    _fields_ = [
        ("n", ctypes.c_int),
        ("is_first", ctypes.c_int),
        ("time", ctypes.c_double),
        ("timestep", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in ARRAYS),
    ]


def load(file: str, name: str) -> Any:
    """Returns a function of a library, which takes the address of a structure.

    Raises:
        OSError: the library cannot be loaded.
        AttributeError: there is no such function.
    """
    function = getattr(ctypes.CDLL(file), name)
    function.restype = None
    function.argtypes = [ctypes.c_void_p]
    return function


def main(file: str, name: str, path: str, *numbers: str) -> None:
    """Loads a library, and calls its function once for each received byte.

    Args:
        *numbers: file descriptors of the pipes to read from and to write to, number of joints, time
            step in seconds, and 1 if gravity is passed.
    """
    import faulthandler
    import mmap
    import os
    import sys

    faulthandler.enable()
    read_end, write_end, n = map(int, numbers[:3])
    timestep, has_gravity = float(numbers[3]), numbers[4] == "1"
    try:
        function = load(file, name)
    except (OSError, AttributeError) as error:
        print(error, file=sys.stderr, flush=True)
        os.write(write_end, NOT_LOADED if isinstance(error, OSError) else NO_FUNCTION)
        return
    handle = os.open(path, os.O_RDWR)
    memory = mmap.mmap(handle, 0)
    os.close(handle)
    begin = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    time = ctypes.c_double.from_buffer(memory)
    robot = RobotStruct(n=n, is_first=1, timestep=timestep)
    for k, array in enumerate(ARRAYS):
        setattr(robot, array, begin + HEAD + 8 * n * k)
    if not has_gravity:
        robot.gravity = None
    address = ctypes.addressof(robot)
    os.write(write_end, READY)
    while os.read(read_end, 1):
        robot.time = time.value
        function(address)
        robot.is_first = 0
        os.write(write_end, DONE)


if __name__ == "__main__":
    import sys

    main(*sys.argv[1:])
