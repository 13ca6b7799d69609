"""A fit as a whole process: its CPU time with all that it imports."""

import os
import subprocess
import sys
import tempfile
from typing import Any


def _use(*arguments: str) -> float:
    # where bytecode is not kept, every process compiles all sources first, which no user's does twice
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    process = subprocess.Popen([sys.executable, *arguments], stdout=subprocess.DEVNULL, env=environment)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{' '.join(arguments)} ended with status {process.returncode}")
    return usage.ru_utime + usage.ru_stime


def fits(rounds: int) -> dict[str, Any]:
    """Fits of the demonstration, recorded by another process."""
    with tempfile.TemporaryDirectory() as name:
        _use("-m", "rig", "run", "configs/demo.toml", "-o", f"{name}/session")
        record = f"{name}/session/run-1.mcap"
        took = [_use("-m", "rig", "fit", record, "-o", f"{name}/{k}") for k in range(rounds)]
    return {"rig fit of the demonstration, CPU s": min(took)}


def run(quick: bool = False) -> dict[str, Any]:
    """All numbers; `quick` takes fewer repetitions."""
    return fits(2 if quick else 5)
