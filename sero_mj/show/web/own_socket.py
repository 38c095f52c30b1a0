"""A listening socket for this process alone: Studio's user interface comes to its server by TCP.

Any website, and any other user of this machine, can connect to a port of loopback, and would
take the place of the user interface.
"""

from __future__ import annotations

import os
import socket
import stat
from typing import Any

_DESCRIPTORS = "/dev/fd"


class OwnSocket(socket.socket):
    """Accepts connections of this process; those of others are closed at once."""

    def accept(self) -> tuple[socket.socket, Any]:
        """See `socket.socket`; raises ConnectionAbortedError for a connection of others."""
        connection, address = super().accept()
        if is_own(address):
            return connection, address
        connection.close()
        raise ConnectionAbortedError("it is another process")


def is_own(address: Any) -> bool:
    """Whether a socket of this process has this address; True where that cannot be found out."""
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
        except OSError:  # closed meanwhile
            continue
    return False
