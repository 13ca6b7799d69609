"""A fit as a whole process: its CPU time with all that it imports."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

DEMO_SPOTS = 119_000


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
    """Fits of the demonstration's length, on a record made by another process."""
    program = "import sys; from pathlib import Path; from tests.rig.long_record import make_long_record; "
    program += "make_long_record(Path(sys.argv[1]), int(sys.argv[2]))"
    with tempfile.TemporaryDirectory() as name:
        record = Path(name) / "run.mcap"
        _use("-c", program, str(record), str(DEMO_SPOTS))
        took = [_use("-m", "rig", "fit", str(record), "-o", f"{name}/{k}") for k in range(rounds)]
    return {"rig fit of 119,000 spots, CPU s": min(took)}


def run(quick: bool = False) -> dict[str, Any]:
    """All numbers; `quick` takes fewer repetitions."""
    return fits(2 if quick else 5)
