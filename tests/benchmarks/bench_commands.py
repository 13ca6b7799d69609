"""Commands as whole processes: CPU time of a fit with all that it imports, and memory on a day's record."""

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table

from tests.rig.long_record import DAY_SPOTS

DEMO_SPOTS = 119_000
_NOTHING = "import numpy, scipy.optimize, numba, pydantic"
"""What a fit cannot do without."""


class _Use(NamedTuple):
    """CPU time of a process, and the most memory that it occupied."""

    cpu_s: float
    resident_mib: float


def run(quick: bool = False) -> dict[str, Any]:
    """All numbers; `quick` takes fewer repetitions and an hour instead of a day."""
    results: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        results |= fits(2 if quick else 5)
        spots = DAY_SPOTS // 24 if quick else DAY_SPOTS
        record = _made(folder / "day.mcap", spots)
        results["day, spots"] = spots
        for command in ("record info", "record check", "fit"):
            options = ["-o", str(folder / "day")] if command == "fit" else []
            used = _rig(command, str(record), *options)
            results[f"day, rig {command}, MiB resident"] = used.resident_mib
            results[f"day, rig {command}, CPU s"] = used.cpu_s
    table = Table("commands", "measured")
    for key, value in results.items():
        table.add_row(key, f"{value:,.4g}" if isinstance(value, float) else str(value))
    Console().print(table)
    return results


def fits(rounds: int) -> dict[str, Any]:
    """Fits of the demonstration's length alone."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        return _fit(_made(folder / "run.mcap", DEMO_SPOTS), folder, rounds)


def _made(path: Path, spots: int) -> Path:
    """A record made by another process: a child's most memory is never less than its parent's was."""
    program = "import sys; from pathlib import Path; from tests.rig.long_record import make_long_record; "
    program += "make_long_record(Path(sys.argv[1]), int(sys.argv[2]))"
    _use("-c", program, str(path), str(spots))
    return path


def _fit(record: Path, folder: Path, rounds: int) -> dict[str, Any]:
    """A fit of the demonstration's length, its imports alone, and the help, in turns."""
    least = {"fit": float("inf"), "imports": float("inf"), "help": float("inf")}
    for number in range(rounds):
        least["fit"] = min(least["fit"], _rig("fit", str(record), "-o", str(folder / f"fit-{number}")).cpu_s)
        least["imports"] = min(least["imports"], _use("-c", _NOTHING).cpu_s)
        least["help"] = min(least["help"], _rig("--help").cpu_s)
    return {
        "rig fit of 119,000 spots, CPU s": least["fit"],
        "rig fit, against importing numpy, scipy.optimize, numba, pydantic": least["fit"] / least["imports"],
        "rig --help, CPU s": least["help"],
    }


def _rig(*arguments: str) -> _Use:
    return _use("-m", "rig", *arguments)


def _use(*arguments: str) -> _Use:
    # where bytecode is not kept, every process compiles all sources first, which no user's does twice
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    process = subprocess.Popen([sys.executable, *arguments], stdout=subprocess.DEVNULL, env=environment)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{' '.join(arguments)} ended with status {process.returncode}")
    return _Use(usage.ru_utime + usage.ru_stime, _bytes_resident(usage) / 2**20)


def _bytes_resident(usage: resource.struct_rusage) -> int:
    return usage.ru_maxrss if sys.platform == "darwin" else usage.ru_maxrss * 1024


if __name__ == "__main__":
    run()
