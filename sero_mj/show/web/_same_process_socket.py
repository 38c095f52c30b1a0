"""A listening socket that only accepts connections of the same process.

Studio's user interface connects to its server by TCP. Any website, and any other user of this
machine, can connect to a loopback port and could take the place of the user interface.
"""

from __future__ import annotations

import os
import socket
import stat
from typing import Any

_DESCRIPTORS = "/dev/fd"


class SameProcessSocket(socket.socket):
    """A socket that accepts connections of this process and closes all others at once."""

    def accept(self) -> tuple[socket.socket, Any]:
        """See `socket.socket`; raises ConnectionAbortedError for another process."""
        connection, address = super().accept()
        if is_same_process(address):
            return connection, address
        connection.close()
        raise ConnectionAbortedError("it is another process")


def is_same_process(address: Any) -> bool:
    """Whether a socket of this process has this address; True if this cannot be determined."""
    try:
        numbers = [int(name) for name in os.listdir(_DESCRIPTORS)]
    except OSError:  # Windows
        return True
    for number in numbers:
        try:
            if not stat.S_ISSOCK(os.fstat(number).st_mode):
                continue
            with socket.socket(fileno=os.dup(number)) as each:
                if each.getsockname() == address:
                    return True
        except OSError:  # closed in the meantime
            continue
    return False
