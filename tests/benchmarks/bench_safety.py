"""Faults and what came of them: light that goes, who was needed for the next one.

Run as ``python -m tests.benchmarks safety [--quick]``. The firmware runs on MicroPython, its line can
be cut, the program in processes of its own; the table of single faults is build/safety.md. Beside it, random
sequences of faults, keys and commands on a stepped clock. SAFETY_TRIALS chooses trials by words in them.
"""

import os
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tests.benchmarks import safety_lasers
from tests.benchmarks.safety_faults import CABLE, KEYS, SIGNALS, Row, measured
from tests.benchmarks.safety_program import PLACES
from tests.benchmarks.safety_sequences import run_sequences
from tests.rig.control.conftest import interpreter

EVERYTHING = (*SIGNALS, *KEYS, *CABLE)
OFTEN = (
    "killed",
    "stopped (SIGSTOP), and goes on",
    "told to end (SIGTERM)",
    "interlock opened for 1.5 s",
    "interlock opened for 20 ms, TRIP line lost",
    "cable pulled, interlock opened meanwhile, put in again",
    "board reset",
)
TRIALS = [
    *(("run", fault) for fault in (*EVERYTHING, *PLACES)),
    *(("align", fault) for fault in (*OFTEN, "camera stalls", "control thread hangs", "Ctrl-C")),
    *(("calibration", fault) for fault in (*OFTEN, "disk hangs", "processing hangs", "Ctrl-C")),
    *(("balance", fault) for fault in (*OFTEN, "processing hangs")),
    *(("preflight", fault) for fault in OFTEN[:5]),
    ("doctor", "interlock opened and left open"),
]


def sequences(quick: bool = False) -> dict[str, Any]:
    """The random sequences alone, which need no interpreter."""
    return run_sequences(50 if quick else 1000, 30)


def run(quick: bool = False) -> dict[str, Any]:
    """Measure; the table is also printed."""
    trials = TRIALS[:3] if quick else TRIALS
    if wanted := os.environ.get("SAFETY_TRIALS"):
        trials = [trial for trial in TRIALS if wanted in " ".join(trial)]
    found = sequences(quick)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        package = interpreter(folder)
        if isinstance(package, str):
            return {"sequences": found, "skipped": package}

        def one(number: int) -> Row:
            path, fault = trials[number]
            try:
                row = measured(package, folder / f"trial{number}", path, fault)
            except Exception as error:
                row = Row(path, fault, None, 0, "", f"{type(error).__name__}: {error}")
            print(row.line, flush=True)
            return row

        with ThreadPoolExecutor(2) as at_once:
            rows = list(at_once.map(one, range(len(trials))))
        rows += [safety_lasers.measured(*trial, folder) for trial in safety_lasers.TRIALS]
    head = ("| path | fault | dark after, s | light takes then |", "|---" * 4 + "|")
    text = "".join(f"{line}\n" for line in (*head, *(row.line for row in rows)))
    target = Path("build") / "safety.md"
    target.parent.mkdir(exist_ok=True)
    target.write_text(text, encoding="utf-8")
    wrong = [row for row in rows if row.violation]
    return {
        "sequences": found,
        "rows": [asdict(row) for row in rows],
        "lit by itself": sum(row.relit for row in rows),
        "violations": [f"{row.path}: {row.fault}: {row.violation}" for row in wrong],
        "longest dark, s": max((row.dark_s for row in rows if row.dark_s is not None), default=None),
    }
