"""What an archive believes: random histories against a model, flipped bits, commands killed at every moment.

Run as ``python -m tests.benchmarks archive_trust [--quick]``; `RIG_BENCH_HISTORIES`, `RIG_BENCH_FLIPS` and
`RIG_BENCH_KILLS` name other numbers than 1,000, 1,000 and 200. Seeds are fixed.
"""

import contextlib
import io
import os
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, seed, settings
from hypothesis.stateful import run_state_machine_as_test

from tests.rig.archive import histories
from tests.rig.archive.killed_commands import kills
from tests.rig.archive.test_check import check_flips, files, make_archive

_STEPS = 12


def run(quick: bool = False) -> dict[str, Any]:
    """All numbers; `quick` takes ten histories, one flip a file and 16 kills."""
    results: dict[str, Any] = {}

    def tell(**measured: Any) -> None:
        results.update(measured)
        for key, value in measured.items():
            print(f"  {key}: {value}", flush=True)

    tell(**_histories(int(os.environ.get("RIG_BENCH_HISTORIES", "10" if quick else "1000"))))
    tell(**flips(int(os.environ.get("RIG_BENCH_FLIPS", "12" if quick else "1000"))))
    tell(**kills(int(os.environ.get("RIG_BENCH_KILLS", "16" if quick else "200"))))
    return results


def _histories(count: int) -> dict[str, Any]:
    """Histories whose list is not the model's end it with an error that shows the shortest of them."""
    began_s, done, steps = time.process_time(), 0, 0
    # in parts, so that a run that is ended tells what it has seen
    while done < count:
        part = min(10, count - done)
        histories.Histories.steps = 0
        with contextlib.redirect_stderr(io.StringIO()):
            run_state_machine_as_test(
                seed(done)(histories.Histories),
                settings=settings(
                    max_examples=part,
                    stateful_step_count=_STEPS,
                    deadline=None,
                    database=None,
                    suppress_health_check=list(HealthCheck),
                ),
            )
        done, steps = done + part, steps + histories.Histories.steps
        print(f"  histories so far: {done} as the model ({steps} comparisons)", flush=True)
    return {
        "histories": count,
        "histories: as the model": done,
        "histories: comparisons": steps,
        "histories: CPU s": round(time.process_time() - began_s),
    }


def flips(count: int) -> dict[str, Any]:
    """Bits changed in all kinds of files: how many the archive believed."""
    with tempfile.TemporaryDirectory() as name, contextlib.redirect_stdout(io.StringIO()):
        folder = Path(name)
        os.environ["XDG_DATA_HOME"] = f"{name}/data"
        whole = make_archive(folder)
        archive = shutil.copytree(whole, folder / "copy")
        kinds = {path.relative_to(archive).parts[0] for path in files(archive)}
        per_file = -(-count // len(files(archive)))
        flipped, believed, unnamed = check_flips(archive, per_file, 7)
    return {
        "flips": flipped,
        "flips: kinds of files": ", ".join(sorted(kinds)),
        "flips: believed": believed,
        "flips: not named by check": unnamed,
    }
