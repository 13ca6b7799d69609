"""Child processes that do not receive Ctrl-C from the terminal, and ports of the loopback for them."""

import os
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

LOOPBACK = "127.0.0.1"


def own_group() -> dict[str, Any]:
    """Arguments of `subprocess.Popen` for a process in a process group of its own, without a console."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
    return {"start_new_session": True}


def start_python(*words: str, **how: Any) -> "subprocess.Popen[Any]":
    """Start this interpreter in a group of its own, with this program importable; `how` as for `Popen`.

    What `env` states is added to this process's own environment.
    """
    project = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join(part for part in (project, os.environ.get("PYTHONPATH")) if part)
    environment = {**os.environ, **how.pop("env", {}), "PYTHONPATH": path}
    return subprocess.Popen([sys.executable, "-P", *words], env=environment, **how, **own_group())


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
