"""Work for processes that end in the middle of it; in a module that imports nothing of the project."""

import os
import signal
from pathlib import Path


def deadly(task: str) -> str:
    """Ends its process where the task says so: always, or the first time."""
    kind, _, path = task.partition(":")
    first = kind == "once" and not Path(path).exists()
    if first:
        Path(path).touch()
    if kind == "poison":
        # as a fault in a library
        os.kill(os.getpid(), signal.SIGSEGV)
    if first or kind == "greedy":
        os.kill(os.getpid(), signal.SIGKILL)
    return f"did {task}"
