"""Ports of the loopback interface, which other machines cannot reach."""

import os
import socket

LOOPBACK = "127.0.0.1"


def free_port(preferred: int) -> int:
    """The preferred port of 127.0.0.1 if it is free, otherwise any free one (also if it is 0)."""
    for port in (preferred, 0):
        with socket.socket() as probe:
            if os.name == "posix":
                # Connections of a server that has just ended (TIME_WAIT) do not prevent the use of its port.
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((LOOPBACK, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise OSError(f"no free port on {LOOPBACK}")
