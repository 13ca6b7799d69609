"""Work that ends its process; apart, since processes that are started for it import this alone."""

import os
import signal
from pathlib import Path
from typing import NamedTuple


class Deadly(NamedTuple):
    """A task, whose folder's name says what it does to its process."""

    folder: Path


def outcome_of(task: Deadly) -> str:
    """Ends its process as a fault in a library does, once or each time, or raises."""
    kind, marker = task.folder.name, task.folder.parent / "once"
    if kind == "poison" or (kind == "once" and not marker.exists()):
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if kind == "fault":
        raise ValueError("of this one alone")
    return ""
