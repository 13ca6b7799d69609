"""Ports on this machine alone."""

import os
import socket

LOOPBACK = "127.0.0.1"


def free_port(preferred: int) -> int:
    """The preferred port of 127.0.0.1 where it is free, else any free one."""
    for port in (preferred, 0):
        with socket.socket() as probe:
            if os.name == "posix":
                # A server that just ended leaves its connections behind, which do not hold the port.
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((LOOPBACK, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise OSError(f"no free port on {LOOPBACK}")
