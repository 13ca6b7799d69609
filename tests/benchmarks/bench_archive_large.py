"""A large archive: 100,000 runs listed, its files and records checked, refits whose processes are killed.

Run as ``python -m tests.benchmarks archive_large [--quick]``; `RIG_BENCH_ROWS`, `RIG_BENCH_CHECKED` and
`RIG_BENCH_REFITTED` name other numbers than 100,000 runs, 2,000 sessions and 100 runs. Listed are clones of
the rows of real records, ten runs a session, written by the archive's own code without waiting for the disk.
"""

import contextlib
import hashlib
import os
import random
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any
from unittest.mock import patch

from rig.archive import add_sessions
from rig.archive.facts import Fact
from rig.archive.session_rows import session_rows
from rig.archive.store import Archive
from tests.benchmarks.bench_archive import _LISTED, _command, _taken
from tests.rig.archive.many_sessions import RUNS, make_sessions
from tests.rig.archive.test_refit import started_by

_RUNS_A_SESSION = 10
_KILLED_EVERY_S = float(os.environ.get("RIG_BENCH_KILLED_EVERY_S", "20"))
_BLOCK = 1 << 20


def run(quick: bool = False) -> dict[str, Any]:
    """All numbers; `quick` takes a hundredth."""
    results: dict[str, Any] = {}

    def tell(**measured: Any) -> None:
        results.update(measured)
        for key, value in measured.items():
            print(f"  {key}: {f'{value:,.4g}' if isinstance(value, float) else value}", flush=True)

    def count(name: str, usual: int) -> int:
        return int(os.environ.get(f"RIG_BENCH_{name}", str(usual // 100 if quick else usual)))

    for part, number in (
        (_listed, count("ROWS", 100_000)),
        (_refitted, max(6, count("REFITTED", 100))),
        (_checked, count("CHECKED", 2_000)),
    ):
        with tempfile.TemporaryDirectory() as name:
            tell(**part(Path(name), number))
    return results


def _listed(folder: Path, rows: int) -> dict[str, Any]:
    archive = folder / "archive"
    made = [session_rows(place).rows for place in make_sessions(folder / "runs", 8, templates=8)]
    store = Archive(archive)
    store.begin()
    facts = []
    with patch.object(os, "fsync", lambda number: None):
        for session in range(rows // _RUNS_A_SESSION):
            clones = []
            for run_number in range(_RUNS_A_SESSION):
                row = dict(made[session % len(made)][run_number % RUNS])
                digest = hashlib.sha256(f"{session} {run_number}".encode()).hexdigest()
                name = hashlib.sha256(f"{session}".encode()).hexdigest()
                told = {"sha256": digest, "session": name, "run": f"run-{run_number + 1}", "state": "whole"}
                clones.append(row | told)
            version, sha256 = store.sessions.write(clones[0]["session"], clones)
            seen = "2026-11-25T00:00:00+00:00"
            facts.append(Fact("rig-1", f"/runs/{session:05d}", version, sha256, "", seen))
        for first in range(0, len(facts), 1000):
            store.log.write(facts[first : first + 1000])
        store.merge()
    _taken("list", "limit 1", "--archive", archive)  # compiles bytecode
    results: dict[str, Any] = {"listed: runs": rows}
    for what, words in (("first ten", "limit 10"), ("by a condition", _LISTED)):
        spent = [_taken("list", words, "--archive", archive) for _ in range(5)]
        results[f"listed: {what}, CPU s"] = min(seconds for _, seconds in spent)
        results[f"listed: {what}, MiB"] = min(peak for peak, _ in spent)
    # what a list of ten runs takes with the same libraries: start and imports
    small = folder / "small"
    add_sessions(small, [folder / "runs"])
    _taken("list", "limit 1", "--archive", small)
    results["listed: of 24 runs, CPU s"] = min(
        _taken("list", "limit 10", "--archive", small)[1] for _ in range(5)
    )
    return results


def _refitted(folder: Path, runs: int) -> dict[str, Any]:
    """The same records by two processes, undisturbed, and by two of which one is killed all the time."""
    for _ in make_sessions(folder / "runs", -(-runs // RUNS), templates=6, seed=5):
        pass
    found, times, killed = [], [], 0
    for name in ("undisturbed", "killed"):
        archive = folder / name
        add_sessions(archive, [folder / "runs"])
        began_s = time.monotonic()
        with subprocess.Popen(
            [*_command("refit", "--archive", archive), "--processes", "2"], stdout=subprocess.DEVNULL
        ) as process:
            moments, next_s = random.Random(6), time.monotonic() + _KILLED_EVERY_S
            while process.poll() is None:
                time.sleep(0.1)
                workers = list(started_by(process.pid))
                if name == "killed" and time.monotonic() > next_s and workers:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(moments.choice(workers), signal.SIGKILL)
                        killed += 1
                    next_s = time.monotonic() + _KILLED_EVERY_S
        times.append(time.monotonic() - began_s)
        question = "select * exclude (made_utc, added_utc, turn) from refits order by all"
        connection = Archive(archive).connection(refits=True)
        names = {item[0] for item in connection.execute("select * from refits limit 0").description}
        question = question if "turn" in names else question.replace(", turn", "")
        found.append([str(row) for row in connection.execute(question).fetchall()])
        quarantine = archive / "quarantine"
        found.append([path.name for path in quarantine.iterdir()] if quarantine.is_dir() else [])
    undisturbed, _, disturbed, given_up = found
    return {
        "refitted: runs": len(undisturbed),
        "refitted: processes killed": killed,
        "refitted: undisturbed, s": times[0],
        "refitted: with kills, s": times[1],
        "refitted: rows that differ or are missing": len(set(undisturbed) ^ set(disturbed)),
        "refitted: given up": len(given_up),
    }


def _checked(folder: Path, sessions: int) -> dict[str, Any]:
    archive, runs = folder / "archive", folder / "runs"
    for _ in make_sessions(runs, sessions):
        pass
    add_sessions(archive, [runs])
    results: dict[str, Any] = {"checked: sessions": sessions}
    for what, place, pattern, words in (
        ("files of the archive", archive, "*", ()),
        ("records, too", runs, "*.mcap", ("--records",)),
    ):
        paths = sorted(path for path in place.rglob(pattern) if path.is_file())
        size_mb = sum(path.stat().st_size for path in paths) / 1e6
        results[f"checked: {what}, MB in {len(paths)} files"] = size_mb
        _forget(paths)
        began_s = time.monotonic()
        for path in paths:
            with path.open("rb") as file:
                while file.read(_BLOCK):
                    pass
        results[f"checked: {what}, MB/s that the disk reads"] = size_mb / (time.monotonic() - began_s)
        _forget(paths)
        began_s = time.monotonic()
        peak_mib, spent_s = _taken("check", *words, "--archive", archive)
        results[f"checked: {what}, MB/s"] = size_mb / (time.monotonic() - began_s)
        results |= {f"checked: {what}, CPU s": spent_s, f"checked: {what}, MiB resident": peak_mib}
    return results


def _forget(paths: list[Path]) -> None:
    """Have the system forget what it holds of files in memory."""
    os.sync()
    for path in paths:
        number = os.open(path, os.O_RDONLY)
        try:
            os.posix_fadvise(number, 0, 0, os.POSIX_FADV_DONTNEED)
        finally:
            os.close(number)
