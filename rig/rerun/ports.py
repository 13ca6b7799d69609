"""Ports of the loopback interface, which other machines cannot reach."""

import os
import secrets
import socket
import sys

LOOPBACK = "127.0.0.1"


def hidden_loopback() -> str:
    """A loopback address that a foreign page cannot guess; on other systems than Linux there is only one."""
    if not sys.platform.startswith("linux"):
        return LOOPBACK
    return ".".join(["127", *(str(1 + secrets.randbelow(254)) for _ in range(3))])


def free_port(preferred: int, host: str = LOOPBACK) -> int:
    """The preferred port of a loopback address if it is free, otherwise any free one (also if it is 0)."""
    for port in (preferred, 0):
        with socket.socket() as probe:
            if os.name == "posix":
                # Connections of a server that has just ended (TIME_WAIT) do not prevent the use of its port.
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise OSError(f"no free port on {host}")
