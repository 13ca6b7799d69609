"""Child processes that do not receive Ctrl-C from the terminal."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any


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
