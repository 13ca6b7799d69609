"""Child processes that the terminal's Ctrl-C does not reach."""

import subprocess
import sys
from typing import Any


def own_group() -> dict[str, Any]:
    """Arguments for `subprocess.Popen` that start a process in a group of its own, without a console."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
    return {"start_new_session": True}
