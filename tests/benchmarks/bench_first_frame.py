"""From `rig run` to its first tracked frame, and to the first picture in the display: cold and warm.

Cold: no module is compiled to bytecode yet, neither ours nor a library's; warm: all are. The kernels are
compiled in both. The simulated rig in real time, with controller, laser and display, which writes a file.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

from tests.rig.command_line import CONFIGS

_PROGRAM = """
import sys, threading, time

def first_tracked():
    name = "rig.instrument.pipeline"
    while not hasattr(sys.modules.get(name), "Pipeline"):
        time.sleep(0.005)
    pipeline = sys.modules[name].Pipeline
    usual = pipeline.process

    def process(self, frames):
        block = usual(self, frames)
        if block.spots:
            pipeline.process = usual
            print("tracked", time.monotonic(), time.process_time(), flush=True)
        return block

    pipeline.process = process

threading.Thread(target=first_tracked, daemon=True).start()
from rig.cli import main
main()
"""
"""The command, which says when its pipeline has tracked a frame."""
_SETS = {
    "session.max_duration_s": "2",
    "preflight.when": "never",
    "start.way": "at once",
    "simulation.release.way": "let go",
}
_JPEG = b"\xff\xd8\xff"
"""How each picture of the display begins."""
_LIMIT_S = 600.0


class _Start(NamedTuple):
    """Since the command was given: time to the first tracked frame, CPU until then, time to the picture."""

    tracked_s: float
    cpu_s: float
    picture_s: float


def run(quick: bool = False) -> dict[str, Any]:
    """Medians of some starts, cold and warm in turns."""
    found: dict[str, list[_Start]] = {"cold": [], "warm": []}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # the kernels are compiled here, where they are not yet
        _started(folder / "kernels", folder / "bytecode-kernels")
        for number in range(2 if quick else 7):
            bytecode = folder / f"bytecode-{number}"
            for kind, starts in found.items():
                starts.append(_started(folder / f"{kind}-{number}", bytecode))
    results: dict[str, Any] = {}
    for kind, starts in found.items():
        for value, what in zip(
            zip(*starts, strict=True),
            ("to the first tracked frame, s", "CPU until then, s", "to the first picture, s"),
            strict=True,
        ):
            results[f"{kind}, {what}"] = statistics.median(value)
            middle, least, most = statistics.median(value), min(value), max(value)
            print(f"{kind + ', ' + what:<40} {middle:.2f} ({least:.2f} to {most:.2f})")
    return results


def _started(out: Path, bytecode: Path) -> _Start:
    sets = [word for key, value in _SETS.items() for word in ("--set", f"{key}={value}")]
    began_s = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-c", _PROGRAM, "run", str(CONFIGS / "live.toml"), "-o", str(out), *sets],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "PYTHONPYCACHEPREFIX": str(bytecode), "PYTHONDONTWRITEBYTECODE": ""},
    )
    assert process.stdout is not None
    display, picture_s = out / "run-1.rrd", None
    while picture_s is None and process.poll() is None and time.monotonic() < began_s + _LIMIT_S:
        if display.exists() and _JPEG in display.read_bytes():
            picture_s = time.monotonic() - began_s
        time.sleep(0.01)
    said = [line.split() for line in process.communicate()[0].splitlines()]
    (tracked,) = [words[1:] for words in said if words[:1] == ["tracked"]]
    if picture_s is None:
        raise RuntimeError(f"{display}: no picture came")
    return _Start(float(tracked[0]) - began_s, float(tracked[1]), picture_s)


if __name__ == "__main__":
    run()
